/** The API over fetch: same-origin cookie, CSRF token on what changes something, problems as errors with advice. */
import { forgetFiles } from "../stream/kept";
import type { JobRequest, Opening, Problem, Route, UploadListReply, UploadReply, UsageReply } from "./schema";
import type { Device, DevicePage, EventPage, JobDetail, JobEvent, JobPage, JobState, Scene, SceneObjects, Session, ShardPage, Storage, WorkerPage } from "./types";

/** The service said no: what is wrong, what to do, and which setting it is about. */
export class Refused extends Error {
  readonly code: string;
  readonly status: number;
  readonly advice: string;
  readonly key: string | null;
  constructor(problem: Partial<Problem> & { status: number }) {
    super(problem.detail ?? `the service answered ${problem.status}`);
    this.code = problem.code ?? "Unexpected";
    this.status = problem.status;
    this.advice = problem.advice ?? "";
    this.key = problem.key ?? null;
  }
}

/** There was no answer at all. */
export class Unreachable extends Error {
  readonly advice = "Check that the service runs and that you are connected; nothing is lost.";
  constructor() {
    super("The service does not answer.");
  }
}

/** A sentence, and what to do about it, for any error that a call may end with. */
export function explain(error: unknown): { text: string; advice: string } {
  if (error instanceof Refused || error instanceof Unreachable) return { text: error.message, advice: error.advice };
  const advice = (error as { advice?: unknown })?.advice;
  return { text: error instanceof Error ? error.message : String(error), advice: typeof advice === "string" ? advice : "" };
}

let csrf: string | null = null;

export function csrfHeader(): Record<string, string> {
  return csrf ? { "x-csrf-token": csrf } : {};
}

interface Call {
  path?: Record<string, string>;
  query?: Record<string, string | number>;
  body?: unknown;
  headers?: Record<string, string>;
  signal?: AbortSignal;
}

/** Address of a route, its parts filled in and escaped. */
export function addressOf(route: Route, path: Record<string, string> = {}, query: Record<string, string | number> = {}): string {
  const filled = route.slice(route.indexOf(" ") + 1).replace(/\{(\w+)\}/g, (_, name: string) => {
    const value = encodeURIComponent(path[name]);
    return name === "path" ? value.replaceAll("%2F", "/") : value;
  });
  const search = new URLSearchParams(Object.entries(query).map(([k, v]) => [k, String(v)])).toString();
  return search ? `${filled}?${search}` : filled;
}

async function ask(route: Route, call: Call): Promise<Response> {
  const method = route.slice(0, route.indexOf(" "));
  const headers: Record<string, string> = { accept: "application/json", ...call.headers };
  if (method !== "GET" && method !== "HEAD") Object.assign(headers, csrfHeader());
  const init: RequestInit = { method, headers, credentials: "same-origin" };
  if (call.signal) init.signal = call.signal;
  if (call.body !== undefined) {
    headers["content-type"] = "application/json";
    init.body = JSON.stringify(call.body);
  }
  try {
    return await fetch(addressOf(route, call.path, call.query), init);
  } catch (error) {
    if (call.signal?.aborted) throw error;
    throw new Unreachable();
  }
}

/** The problem in an answer that is none. */
export async function problemOf(response: Response): Promise<Refused> {
  const problem = (await response.json().catch(() => ({}))) as Partial<Problem>;
  return new Refused({ ...problem, status: response.status });
}

async function json<T>(route: Route, call: Call = {}): Promise<T> {
  const response = await ask(route, call);
  if (!response.ok) throw await problemOf(response);
  return (response.status === 204 ? undefined : await response.json()) as T;
}

function keep(session: Session): Session {
  csrf = session.csrf_token;
  return session;
}

/** Who we are; null: nobody, sign in first. */
export async function readSession(): Promise<Session | null> {
  try {
    return keep(await json<Session>("GET /v1/session"));
  } catch (error) {
    if (error instanceof Refused && error.status === 401) return null;
    throw error;
  }
}

/** A session begins and ends without what this browser kept for another one. */
export async function signIn(opening: Opening): Promise<Session> {
  const session = keep(await json<Session>("POST /v1/session", { body: opening }));
  await forgetFiles();
  return session;
}
export async function signOut(): Promise<void> {
  await forgetFiles();
  await json("DELETE /v1/session");
}

export function listJobs(query: { state?: JobState; cursor?: string; limit?: number }, signal?: AbortSignal): Promise<JobPage> {
  return json("GET /v1/jobs", { query, ...(signal ? { signal } : {}) });
}
export const readJob = (id: string): Promise<JobDetail> => json("GET /v1/jobs/{job_id}", { path: { job_id: id } });
export const cancelJob = (id: string): Promise<JobDetail> => json("POST /v1/jobs/{job_id}/cancel", { path: { job_id: id } });
export const retryJob = (id: string): Promise<JobDetail> => json("POST /v1/jobs/{job_id}/retry", { path: { job_id: id } });
export const readShards = (id: string, stage: string): Promise<ShardPage> =>
  json("GET /v1/jobs/{job_id}/stages/{stage}/shards", { path: { job_id: id, stage } });
export const readEvents = (id: string, after: number, limit: number, kind?: JobEvent["kind"]): Promise<EventPage> =>
  json("GET /v1/jobs/{job_id}/events", { path: { job_id: id }, query: { after, limit, ...(kind ? { kind } : {}) } });

/** The same key never makes two jobs: a click that is sent twice is harmless. */
export function createJob(request: JobRequest, idempotencyKey: string): Promise<JobDetail> {
  return json("POST /v1/jobs", { body: request, headers: { "idempotency-key": idempotencyKey } });
}

/** report.json of a job, or of a registered folder. */
export const readReport = <T>(of: { job: string } | { placement: string }): Promise<T> =>
  "job" in of
    ? json("GET /v1/jobs/{job_id}/report", { path: { job_id: of.job } })
    : json("GET /v1/placements/{placement}/{path}", { path: { placement: of.placement, path: "report.json" } });

/** The scene of this digest, null where this account has not sent it. */
export async function findScene(digest: string): Promise<Scene | null> {
  try {
    return await json<Scene>("GET /v1/scenes/{digest}", { path: { digest } });
  } catch (error) {
    if (error instanceof Refused && error.status === 404) return null;
    throw error;
  }
}
/** Files on their way in that have this digest, those with most bytes first. */
export const findUploads = async (digest: string): Promise<UploadReply[]> =>
  (await json<UploadListReply>("GET /v1/uploads", { query: { sha256: digest } })).uploads;
export const readUpload = (id: string, signal: AbortSignal): Promise<UploadReply> =>
  json("GET /v1/uploads/{upload_id}", { path: { upload_id: id }, signal });

/** Starts an upload (tus 1.0.0); the service knows what the file shall be when it has all of it. */
export async function startUpload(file: File, digest: string, signal: AbortSignal): Promise<UploadReply> {
  const base64 = (text: string): string => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
  const headers = {
    "tus-resumable": "1.0.0", "upload-length": String(file.size),
    "upload-metadata": `filename ${base64(file.name.slice(-255))},sha256 ${base64(digest)}`,
  };
  const response = await ask("POST /v1/uploads", { headers, signal });
  if (!response.ok) throw await problemOf(response);
  return readUpload(response.headers.get("location")!.split("/").pop()!, signal);
}

export const readObjects = (digest: string): Promise<SceneObjects> => json("GET /v1/scenes/{digest}/objects", { path: { digest } });
export const listDevices = (): Promise<DevicePage> => json("GET /v1/devices", { query: { limit: 200 } });
export const createDevice = (name: string): Promise<Device> => json("POST /v1/devices", { body: { name } });
export const deleteDevice = (id: string): Promise<void> => json("DELETE /v1/devices/{device_id}", { path: { device_id: id } });
/** Adds frames and fits the profile to all there are; the same key adds nothing. */
export const sendSamples = (id: string, samples: readonly object[], key: string): Promise<Device> =>
  json("POST /v1/devices/{device_id}/samples", { path: { device_id: id }, body: { samples }, headers: { "idempotency-key": key } });

/** The operator's: refused with 403 to anybody else. */
export const listWorkers = (): Promise<WorkerPage> => json("GET /v1/workers");
export const readStorage = (): Promise<Storage> => json("GET /v1/storage");
export const readUsage = (): Promise<UsageReply> => json("GET /v1/usage");
