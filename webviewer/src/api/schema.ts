/** Made by scripts/make_api_types.py from the API's OpenAPI document. Do not edit. */

export interface AuditEntry {
  id: number;
  /** RFC 3339, UTC */
  at: string;
  tenant: string;
  /** id of the key; null: the operator, at the machine */
  key: string | null;
  key_name: string;
  address: string;
  action: string;
  target: string;
  status: number;
}

export interface AuditPage {
  entries: AuditEntry[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface BakeSettings {
  flatten?: "none" | "shine" | "all";
  page_format?: "webp" | "png" | "ktx2";
}

export interface CameraSettings {
  fov_deg?: number;
  width?: number;
  height?: number;
}

export interface CurveReply {
  budget: unknown;
  budget_amount: unknown;
  unit: unknown;
  bytes: unknown;
  curve: unknown;
}

export interface DeliveryPage {
  deliveries: DeliveryReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface DeliveryReply {
  /** the webhook-id of its requests: the same at every attempt */
  id: string;
  webhook: string;
  /** null: a test */
  job: string | null;
  event: string;
  state: "pending" | "delivered" | "failed";
  attempt: number;
  /** the receiver's last answer */
  status: number | null;
  /** why there was none */
  error: string | null;
  next_at: string | null;
  /** RFC 3339, UTC */
  created_at: string;
  ended_at: string | null;
}

export interface DeliveryStarted {
  delivery: string;
}

export interface DetailSettings {
  mode?: "auto" | "on" | "off";
}

export interface DeviceLinks {
  self: string;
}

export interface DevicePageReply {
  /** what every service knows */
  presets: Preset[];
  devices: DeviceReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface DeviceProfile {
  per_frame_ns: number;
  per_call_ns: number;
  per_triangle_ns: number;
  per_pixel_ns: number;
  per_impostor_ns: number;
  per_impostor_triangle_ns: number;
  per_impostor_pixel_ns: number;
  fit?: Fit | null;
}

export interface DeviceReply {
  id: string;
  tenant: string;
  name: string;
  samples: number;
  /** see the schema DeviceProfile */
  profile: Record<string, unknown> | null;
  missing: Missing | null;
  /** RFC 3339, UTC */
  created_at: string;
  links: DeviceLinks;
}

export interface DeviceRequest {
  /** what jobs call it in settings.device */
  name: string;
  /** its figures where they are known; else send samples */
  profile?: DeviceProfile | null;
}

export interface EventPageReply {
  events: EventReply[];
  /** number of the last event here: `after` of the next page */
  next: number;
}

export interface EventReply {
  seq: number;
  kind: "job" | "stage" | "shard" | "progress";
  data: Record<string, unknown>;
  /** RFC 3339, UTC */
  at: string;
}

export interface Fit {
  samples: number;
  quantile: number;
  mean_ms: number;
  p95_ms: number;
  worst_ms: number;
  under_share: number;
  unseen_under_share: number;
}

export interface JobDeleted {
  deleted: boolean;
  shards: number;
  events: number;
  artifacts: number;
  bytes: number;
}

export interface JobDetailReply {
  id: string;
  tenant: string;
  name: string;
  /** digest of its scene */
  scene: string;
  budget: string | null;
  priority: "high" | "normal" | "low";
  state: "queued" | "running" | "done" | "failed" | "cancelled";
  verdict: "valid" | "infeasible" | "unproven" | null;
  error: JobError | null;
  /** the one that it is at */
  stage: Stage | null;
  /** what the placement minimises; once the job is done */
  bytes: number | null;
  hopeless_views: number | null;
  smallest_budget: string | null;
  /** share of stages that ended: for a bar, not a promise of time */
  progress: number;
  /** the webhook that the job named */
  webhook: string | null;
  /** RFC 3339, UTC */
  created_at: string;
  started_at: string | null;
  finished_at: string | null;
  links: JobLinks;
  /** all of them: see the schema Settings */
  settings: Record<string, unknown>;
  last_event: number;
  stages: StageReply[];
}

export interface JobError {
  code: string;
  message: string;
  advice?: string;
  stage?: string | null;
}

export interface JobLinks {
  self: string;
  events: string;
  page: string;
  report?: string | null;
  report_page?: string | null;
  placement?: string | null;
  viewer?: string | null;
}

export interface JobPageReply {
  jobs: JobReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface JobReply {
  id: string;
  tenant: string;
  name: string;
  /** digest of its scene */
  scene: string;
  budget: string | null;
  priority: "high" | "normal" | "low";
  state: "queued" | "running" | "done" | "failed" | "cancelled";
  verdict: "valid" | "infeasible" | "unproven" | null;
  error: JobError | null;
  /** the one that it is at */
  stage: Stage | null;
  /** what the placement minimises; once the job is done */
  bytes: number | null;
  hopeless_views: number | null;
  smallest_budget: string | null;
  /** share of stages that ended: for a bar, not a promise of time */
  progress: number;
  /** the webhook that the job named */
  webhook: string | null;
  /** RFC 3339, UTC */
  created_at: string;
  started_at: string | null;
  finished_at: string | null;
  links: JobLinks;
}

export interface JobRequest {
  /** digest of an uploaded scene */
  scene: string;
  /** what is left out has its default */
  settings?: Settings;
  /** what to call it; the scene's name by default */
  name?: string | null;
  /** before or after other jobs of the tenant */
  priority?: "high" | "normal" | "low";
  /** id of a webhook to tell of this job, whether it hears of all or not */
  webhook?: string | null;
}

export interface KeyPage {
  keys: KeyReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface KeyReply {
  id: string;
  tenant: string;
  name: string;
  scopes: ("read" | "submit" | "admin")[];
  /** RFC 3339, UTC */
  created_at: string;
  expires_at: string | null;
  /** to about half a minute */
  last_used_at: string | null;
  revoked_at: string | null;
}

export interface KeyRequest {
  /** what it is for */
  name: string;
  /** read: see; submit: change; admin: keys, webhooks of all, audit */
  scopes: ("read" | "submit" | "admin")[];
  /** seconds until it ends; null: never */
  expires_in_s?: number | null;
}

export interface Missing {
  code: string;
  detail: string;
  advice?: string;
}

export interface NewKeyReply {
  id: string;
  tenant: string;
  name: string;
  scopes: ("read" | "submit" | "admin")[];
  /** RFC 3339, UTC */
  created_at: string;
  expires_at: string | null;
  /** to about half a minute */
  last_used_at: string | null;
  revoked_at: string | null;
  /** what to send as Authorization: Bearer; it is shown once */
  key: string;
}

export interface NewWebhookReply {
  id: string;
  name: string;
  url: string;
  events: ("queued" | "running" | "done" | "failed" | "cancelled")[];
  /** false: told only of jobs that name it */
  every_job: boolean;
  /** false: what happens meanwhile is not told, what waits is kept */
  active: boolean;
  /** RFC 3339, UTC */
  created_at: string;
  /** with which deliveries are signed; it is shown once */
  secret: string;
}

export interface Opening {
  /** an API key */
  key?: string | null;
  /** the token of a login link */
  login?: string | null;
}

export interface PlacementPageReply {
  placements: PlacementReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface PlacementReply {
  id: string;
  name: string;
  verdict: "valid" | "infeasible" | "unproven" | null;
}

export interface PlacementSettings {
  candidates?: "shafts+boxes" | "shafts" | "boxes" | "cells" | "environment";
  far_m?: number;
  view_cells?: "tight" | "raw";
  density?: number;
  assignment?: "fastest" | "least" | "all";
  reverse_delete?: boolean;
  hopeless?: "near_best" | "geometry";
  hopeless_slack?: number;
  regions?: number;
  bound?: "auto" | "lp" | "lagrangian" | "off";
  time_limit_s?: number | null;
  base?: string | null;
}

export interface Preset {
  name: string;
  profile: Record<string, unknown>;
}

export interface Problem {
  type: string;
  title: string;
  status: number;
  /** the error's stable name */
  code: string;
  /** what is wrong, and where */
  detail: string;
  /** what to do */
  advice?: string;
  /** what the operator finds it by in the logs */
  request_id?: unknown;
  /** the setting's dotted name, for SettingsInvalid */
  key?: string;
  /** for RequestInvalid: where and what */
  errors?: (Record<string, unknown>)[];
}

export interface ProofSettings {
  mode?: "sample" | "all" | "off";
  pairs?: number;
  views?: number;
  confidence?: number;
}

export interface QualitySettings {
  pixel_error?: number;
  pixels_at?: "centre" | "anywhere";
}

export interface QuotaReply {
  max_bytes: number | null;
  max_jobs: number | null;
  max_running: number | null;
}

export interface QuotaRequest {
  /** bytes stored */
  max_bytes?: number | null;
  /** jobs stored */
  max_jobs?: number | null;
  /** jobs queued or running */
  max_running?: number | null;
}

export interface RotateRequest {
  /** how long the old key still works */
  grace_s?: number;
  /** of the new key; null: as long as the old one was made for */
  expires_in_s?: number | null;
}

export interface Sample {
  calls: number;
  triangles: number;
  pixels: number;
  impostors: number;
  impostor_triangles: number;
  impostor_pixels: number;
  ms: number;
}

export interface SamplesRequest {
  /** added to those that the device has */
  samples: Sample[];
}

export interface SceneDeleted {
  deleted: boolean;
  /** jobs that need the scene: it cannot be deleted before them */
  jobs: number;
  artifacts: number;
  bytes: number;
}

export interface SceneLinks {
  self: string;
  objects: string;
  picture: string | null;
}

export interface ScenePageReply {
  scenes: SceneReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface SceneReply {
  digest: string;
  tenant: string;
  name: string;
  bytes: number;
  /** RFC 3339, UTC */
  uploaded_at: string;
  objects?: number | null;
  triangles?: number | null;
  materials?: number | null;
  textures?: number | null;
  /** lowest and highest corner, metres */
  bounds?: unknown;
  warnings?: unknown[] | null;
  /** view space, cell and budgets that fit the scene */
  suggested?: unknown;
  links: SceneLinks;
}

export interface SceneSettings {
  unit_m?: number | null;
  up?: "y" | "z" | null;
  split_triangles?: number;
}

export interface Settings {
  budget?: string;
  device?: string;
  device_profile?: DeviceProfile | null;
  seed?: number;
  scene?: SceneSettings;
  camera?: CameraSettings;
  view_space?: ViewSpaceSettings;
  quality?: QualitySettings;
  detail?: DetailSettings;
  visibility?: VisibilitySettings;
  placement?: PlacementSettings;
  proof?: ProofSettings;
  bake?: BakeSettings;
}

export interface ShardCounts {
  total: number;
  ready: number;
  running: number;
  done: number;
  failed: number;
  cancelled: number;
}

export interface ShardPageReply {
  shards: ShardReply[];
}

export interface ShardReply {
  kind: "plan" | "run" | "merge" | "report";
  ordinal: number;
  state: "ready" | "running" | "done" | "failed" | "cancelled";
  attempt: number;
  /** taken over from an earlier job */
  cached: boolean;
  seconds: number | null;
  peak_bytes: number | null;
  worker: string | null;
  error: JobError | null;
}

export type Stage = "scene" | "hierarchy" | "detail" | "rendertime" | "visibility" | "viewspace" | "candidates" | "placement" | "bake" | "repair" | "bound" | "placementdb" | "evaluation" | "proof";

export interface StageReply {
  name: Stage;
  state: "waiting" | "planning" | "running" | "merging" | "reporting" | "done" | "skipped" | "failed";
  /** why it was skipped */
  skipped: string | null;
  shards: ShardCounts;
  seconds: number | null;
  peak_bytes: number | null;
}

export interface Target {
  /** the page to open */
  to?: string;
}

export interface TenantPage {
  tenants: TenantReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface TenantReply {
  id: string;
  name: string;
  /** its admins may act in all tenants */
  operator: boolean;
  /** RFC 3339, UTC */
  created_at: string;
}

export interface TenantRequest {
  name: string;
}

export interface UploadLinks {
  self: string;
  scene: string | null;
}

export interface UploadListReply {
  uploads: UploadReply[];
}

export interface UploadProblem {
  status: number;
  code: string;
  detail: string;
  advice: string;
}

export interface UploadReply {
  id: string;
  name: string;
  /** reading: all bytes have arrived; where nobody reads, a PATCH without bytes makes somebody */
  state: "open" | "reading" | "done" | "refused";
  bytes: number;
  /** bytes that survive a power cut: where to go on */
  received: number;
  /** what the sender announced */
  sha256: string | null;
  /** the digest of the scene that it became */
  scene: string | null;
  problem: UploadProblem | null;
  /** RFC 3339, UTC */
  created_at: string;
  /** RFC 3339, UTC */
  expires_at: string;
  links: UploadLinks;
}

export interface UsageReply {
  tenant: string;
  /** of its scenes, results and intermediate results, each once */
  bytes: number;
  jobs: number;
  /** jobs that are queued or running */
  running: number;
  quota: QuotaReply;
}

export interface ViewSpaceSettings {
  boxes?: ([[number, number, number], [number, number, number]])[] | null;
  cell_m?: number | null;
  interval_deg?: number;
}

export interface VisibilitySettings {
  mode?: "auto" | "sampled" | "conservative" | "off";
  missed_ppm?: number;
  rays?: number;
}

export interface WebhookChange {
  name?: string | null;
  url?: string | null;
  events?: ("queued" | "running" | "done" | "failed" | "cancelled")[] | null;
  every_job?: boolean | null;
  active?: boolean | null;
}

export interface WebhookPage {
  webhooks: WebhookReply[];
  /** cursor of the next page; null: this is the last one */
  next: string | null;
}

export interface WebhookReply {
  id: string;
  name: string;
  url: string;
  events: ("queued" | "running" | "done" | "failed" | "cancelled")[];
  /** false: told only of jobs that name it */
  every_job: boolean;
  /** false: what happens meanwhile is not told, what waits is kept */
  active: boolean;
  /** RFC 3339, UTC */
  created_at: string;
}

export interface WebhookRequest {
  name: string;
  /** https, of a public host */
  url: string;
  /** the states of a job that it is told of */
  events?: ("queued" | "running" | "done" | "failed" | "cancelled")[];
  /** told of all jobs of the tenant (scope admin), or of those that name it */
  every_job?: boolean;
}

/** Every route; the client names no other. */
export type Route =
  | "GET /livez"
  | "GET /metrics"
  | "GET /readyz"
  | "GET /v1/audit"
  | "GET /v1/devices"
  | "POST /v1/devices"
  | "DELETE /v1/devices/{device_id}"
  | "GET /v1/devices/{device_id}"
  | "POST /v1/devices/{device_id}/samples"
  | "GET /v1/jobs"
  | "POST /v1/jobs"
  | "DELETE /v1/jobs/{job_id}"
  | "GET /v1/jobs/{job_id}"
  | "POST /v1/jobs/{job_id}/cancel"
  | "GET /v1/jobs/{job_id}/curve"
  | "GET /v1/jobs/{job_id}/events"
  | "GET /v1/jobs/{job_id}/report"
  | "POST /v1/jobs/{job_id}/retry"
  | "GET /v1/jobs/{job_id}/stages/{stage}/shards"
  | "GET /v1/keys"
  | "POST /v1/keys"
  | "DELETE /v1/keys/{key_id}"
  | "GET /v1/keys/{key_id}"
  | "POST /v1/keys/{key_id}/rotate"
  | "POST /v1/logins"
  | "GET /v1/placements"
  | "GET /v1/placements/{placement}/gltf"
  | "GET /v1/placements/{placement}/{path}"
  | "GET /v1/scenes"
  | "POST /v1/scenes"
  | "DELETE /v1/scenes/{digest}"
  | "GET /v1/scenes/{digest}"
  | "HEAD /v1/scenes/{digest}"
  | "GET /v1/scenes/{digest}/objects"
  | "GET /v1/scenes/{digest}/picture"
  | "DELETE /v1/session"
  | "GET /v1/session"
  | "POST /v1/session"
  | "GET /v1/storage"
  | "GET /v1/tenants"
  | "POST /v1/tenants"
  | "GET /v1/tenants/{tenant_id}"
  | "GET /v1/tenants/{tenant_id}/quota"
  | "PUT /v1/tenants/{tenant_id}/quota"
  | "GET /v1/uploads"
  | "POST /v1/uploads"
  | "DELETE /v1/uploads/{upload_id}"
  | "GET /v1/uploads/{upload_id}"
  | "HEAD /v1/uploads/{upload_id}"
  | "PATCH /v1/uploads/{upload_id}"
  | "GET /v1/usage"
  | "GET /v1/webhooks"
  | "POST /v1/webhooks"
  | "DELETE /v1/webhooks/{webhook_id}"
  | "GET /v1/webhooks/{webhook_id}"
  | "PATCH /v1/webhooks/{webhook_id}"
  | "GET /v1/webhooks/{webhook_id}/deliveries"
  | "POST /v1/webhooks/{webhook_id}/deliveries/{delivery_id}/redeliver"
  | "POST /v1/webhooks/{webhook_id}/rotate"
  | "POST /v1/webhooks/{webhook_id}/test"
  | "GET /v1/workers";
