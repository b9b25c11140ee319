/** What the API answers. tests/api/test_types.py holds every key here that is not optional against real answers. */
import type { DeviceProfile, Settings, Stage } from "./schema";

export type JobState = "queued" | "running" | "done" | "failed" | "cancelled";
export type StageState = "waiting" | "planning" | "running" | "merging" | "reporting" | "done" | "skipped" | "failed";
export type ShardState = "ready" | "running" | "done" | "failed" | "cancelled";
export type ShardKind = "plan" | "run" | "merge" | "report";
export type Verdict = "valid" | "infeasible" | "unproven";
export type Vec3 = [number, number, number];
export type Box = [Vec3, Vec3];

export interface Session {
  tenant: string;
  scopes: string[];
  csrf_token: string | null;
}

export interface JobError {
  code?: string;
  message?: string;
  advice?: string;
  stage?: string;
}

export interface JobLinks {
  self: string;
  events: string;
  page: string;
  report?: string;
  report_page?: string;
  placement?: string;
  viewer?: string;
}

export interface Job {
  id: string;
  tenant: string;
  name: string;
  scene: string;
  budget: string;
  priority: "high" | "normal" | "low";
  state: JobState;
  verdict: Verdict | null;
  error: JobError | null;
  stage: Stage | null;
  progress: number;
  /** Of the report, once there is one. */
  bytes: number | null;
  hopeless_views: number | null;
  smallest_budget: string | null;
  /** Id of the webhook that the job named. */
  webhook: string | null;
  created_at: string;
  started_at: string | null;
  finished_at: string | null;
  links: JobLinks;
}

export interface StageRow {
  name: Stage;
  state: StageState;
  skipped: string | null;
  shards: ShardCounts;
  seconds: number | null;
  peak_bytes: number | null;
}

export interface ShardCounts {
  total: number;
  ready: number;
  running: number;
  done: number;
  failed: number;
  cancelled: number;
}

export interface JobDetail extends Job {
  settings: Settings;
  last_event: number;
  stages: StageRow[];
}

export interface JobPage {
  jobs: Job[];
  next: string | null;
}

export interface ShardRow {
  kind: ShardKind;
  ordinal: number;
  state: ShardState;
  attempt: number;
  cached: boolean;
  seconds: number | null;
  peak_bytes: number | null;
  worker: string | null;
  error: JobError | null;
}

export interface ShardPage {
  shards: ShardRow[];
}

export interface JobEvent {
  seq: number;
  kind: string;
  data: EventData;
  at: string;
}

/** Which keys are there depends on the kind: job, stage or shard. */
export interface EventData {
  state?: string;
  stage?: Stage;
  kind?: ShardKind;
  ordinal?: number;
  attempt?: number;
  seconds?: number;
  cached?: boolean;
  skipped?: string;
  shards?: number;
  done?: number;
  verdict?: Verdict | null;
  error?: JobError;
}

export interface EventPage {
  events: JobEvent[];
  next: number;
}

/** What `farfield inspect` says of a level, without its objects. */
export interface Scene {
  digest: string;
  tenant?: string;
  name: string;
  bytes: number;
  uploaded_at: string;
  objects: number;
  triangles: number;
  warnings: string[];
  calls?: number;
  meshes?: number;
  bounds?: Box;
  materials?: number;
  textures?: number;
  dropped_triangles?: number;
  texture_bytes?: number;
  texture_pixels?: number;
  replaceable?: number;
  suggested?: Suggestion;
  /** `picture`: PNG from above, -z up; null for a scene that is too large to draw quickly. */
  links?: { self: string; objects: string; picture: string | null };
}

export interface Suggestion {
  view_space: { boxes: Box[]; cell_m: number; interval_deg: number };
  work: { cells: number; directions: number; views: number; seconds: number };
  budgets: string[];
  why: Record<string, string>;
}

export interface SceneObject {
  id: number;
  name: string;
  box: Box;
  triangles: number;
}

export interface SceneObjects {
  objects: SceneObject[];
}

export interface Device {
  id: string;
  tenant: string;
  name: string;
  samples: number;
  profile: DeviceProfile | null;
  missing: { code: string; detail: string; advice: string } | null;
  created_at: string;
  links: { self: string };
}

export interface DevicePage {
  presets: { name: string; profile: DeviceProfile }[];
  devices: Device[];
  next: string | null;
}

export interface Capability {
  cores: number;
  memory_bytes: number;
  version: string;
  /** Known once it has made its OpenGL context. */
  renderer: string | null;
}

export interface Worker {
  name: string;
  host: string;
  queues: string[];
  capability: Capability;
  state: "busy" | "idle" | "silent" | "stopped";
  started_at: string;
  heartbeat_at: string;
  silent_s: number;
  shard: string | null;
  stage: string | null;
  shard_s: number | null;
  done: number;
  failed: number;
  busy_seconds: number;
  shards_per_minute: number;
}

export interface WorkerPage {
  workers: Worker[];
  /** Queue -> how many workers that live take from it. */
  queues: Record<string, number>;
}

export interface StoredKind {
  artifacts: number;
  bytes: number;
}

export interface StoredTenant {
  tenant: string;
  name: string;
  scenes: number;
  scene_bytes: number;
  jobs: number;
  max_bytes: number | null;
}

export interface Storage {
  kinds: Record<string, StoredKind>;
  total: StoredKind;
  tenants: StoredTenant[];
}
