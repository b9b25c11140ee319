/**
 * What the API answers: types of schema.ts under the pages' own names, and by hand what its document leaves open or out.
 * tests/api/test_types.py holds every key by hand here that is not optional against real answers.
 */
import type { EventPageReply, EventReply, JobDetailReply, JobError, JobReply, Settings, ShardReply, Stage, StageReply } from "./schema";

export type { DevicePageReply as DevicePage, DeviceReply as Device, JobError, JobPageReply as JobPage, JobReply as Job, ShardPageReply as ShardPage, ShardReply as ShardRow, StageReply as StageRow } from "./schema";

export type JobState = JobReply["state"];
export type StageState = StageReply["state"];
export type ShardState = ShardReply["state"];
export type ShardKind = ShardReply["kind"];
export type Verdict = NonNullable<JobReply["verdict"]>;
export type Vec3 = [number, number, number];
export type Box = [Vec3, Vec3];

export interface Session {
  tenant: string;
  scopes: string[];
  csrf_token: string | null;
}

export type JobDetail = Omit<JobDetailReply, "settings"> & { settings: Settings };
export type JobEvent = Omit<EventReply, "data"> & { data: EventData };
export type EventPage = Omit<EventPageReply, "events"> & { events: JobEvent[] };

/** The view space from above as the optimiser tells of it: tiles, in scene metres. */
export interface LiveMap {
  boxes: number[]; // low x, low z, high x, high z of each tile
  cost: number[]; // worst predicted cost as geometry
  views: number[]; // problem views
  budget: number;
  unit: string;
}

/** Which keys are there depends on the kind: job, stage, shard or progress. */
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
  error?: Partial<JobError>;
  map?: LiveMap;
  bytes?: number;
  choices?: number;
  impostors?: number;
  unsolved?: number;
  hopeless?: number;
  smallest_budget?: number;
  tiles?: [number, number][]; // of the tiles that changed: place, unsolved views
  first?: boolean; // the tiles that it leaves out have none
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
