/** Files over HTTP: retried with backoff while wanted, cancelled by signal, counted for the streaming panel. */
import type { FetchBytes } from "../placementdb/placement";
import { forgetFiles, type KeptFiles } from "./kept";

export class AccessDenied extends Error {
  constructor() {
    super("This placement belongs to another account, or the session has ended: sign in again.");
  }
}

export interface Traffic {
  bytes: number; // received in all
  failures: number; // in a row; 0 while the connection works
  offline: boolean; // the manifest is one that this browser kept: the service did not answer
  retryAtMs: number;
  fileS: number; // that a file takes, running mean
  busySinceMs: number; // something is on its way since then
  inFlight: number;
  busyMs: number;
  busyBytes: number; // received in busyMs
}

export function makeTraffic(): Traffic {
  return { bytes: 0, failures: 0, offline: false, retryAtMs: 0, fileS: 0.1, busySinceMs: 0, inFlight: 0, busyMs: 0, busyBytes: 0 };
}

/** Bytes a second that the line carried while it was asked to; 0: not known yet. */
export function bandwidth(t: Traffic): number {
  return t.busyMs > 50 ? (1000 * t.busyBytes) / t.busyMs : 0;
}

function begin(t: Traffic): void {
  if (t.inFlight++ === 0) t.busySinceMs = performance.now();
}

function end(t: Traffic, beganMs: number, bytes: number): void {
  const now = performance.now();
  t.busyMs += now - t.busySinceMs;
  t.busySinceMs = now;
  t.inFlight--;
  t.busyBytes += bytes;
  if (t.busyMs > 20000) {
    t.busyMs /= 2; // what is long ago counts less
    t.busyBytes /= 2;
  }
  if (bytes) t.fileS += 0.2 * ((now - beganMs) / 1000 - t.fileS);
}

const BACKOFF_MS = [500, 1000, 2000, 4000, 8000];
const MOST_TRIES_ON_5XX = 6;
const AWAY = [429, 502, 503, 504]; // busy, or starting anew behind a proxy: it will be back, as a lost connection will

/** The service answered, but not with the file: worth another try. */
class Unwell extends TypeError {}

/** Resolves to null for 404. A lost connection or a server that is away is retried for ever, a failing one six times; `anew`: past the browser's cache. */
export async function fetchFile(
  url: string, traffic: Traffic, signal?: AbortSignal, onBytes?: (got: number, total: number) => void, anew = false,
): Promise<Uint8Array | null> {
  for (let attempt = 0; ; attempt++) {
    try {
      const bytes = await timed(traffic, () => fetchOnce(url, attempt + 1 >= MOST_TRIES_ON_5XX, traffic, signal, onBytes, anew));
      traffic.failures = 0;
      traffic.offline = false;
      return bytes;
    } catch (error) {
      if (signal?.aborted || !(error instanceof TypeError)) throw error;
      traffic.failures++;
      const wait = BACKOFF_MS[Math.min(attempt, BACKOFF_MS.length - 1)];
      traffic.retryAtMs = performance.now() + wait;
      await delay(wait, signal);
    }
  }
}

/** Throws a TypeError where it is worth another try. */
async function fetchOnce(
  url: string, last: boolean, traffic: Traffic, signal?: AbortSignal, onBytes?: (got: number, total: number) => void, anew = false,
): Promise<Uint8Array | null> {
  const response = await fetch(url, { signal: signal ?? null, credentials: "same-origin", cache: anew ? "reload" : "default" });
  if (response.status === 404) return null;
  if (response.status === 401 || response.status === 403) throw new AccessDenied();
  if (!response.ok) {
    if (response.status < 500 && response.status !== 429) throw new Error(`${url} answered ${response.status}`);
    if (last && !AWAY.includes(response.status)) throw new AccessFailed(url, response.status);
    throw new Unwell(`status ${response.status}`);
  }
  return readBody(response, traffic, onBytes);
}

async function timed(traffic: Traffic, work: () => Promise<Uint8Array | null>): Promise<Uint8Array | null> {
  const beganMs = performance.now();
  begin(traffic);
  let got = 0;
  try {
    const bytes = await work();
    got = bytes?.length ?? 0;
    return bytes;
  } finally {
    end(traffic, beganMs, got);
  }
}

export class AccessFailed extends Error {
  constructor(url: string, status: number) {
    super(`The server answers ${status} for ${url}.`);
  }
}

async function readBody(response: Response, traffic: Traffic, onBytes?: (got: number, total: number) => void): Promise<Uint8Array> {
  const total = Number(response.headers.get("content-length") ?? 0);
  if (!response.body || !onBytes) {
    const bytes = new Uint8Array(await response.arrayBuffer());
    traffic.bytes += bytes.length;
    return bytes;
  }
  const parts: Uint8Array[] = [];
  let got = 0;
  const reader = response.body.getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    got += value.length;
    traffic.bytes += value.length;
    onBytes(got, Math.max(total, got));
  }
  const out = new Uint8Array(got);
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

function delay(ms: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, ms);
    const stop = (): void => {
      clearTimeout(timer);
      reject(signal!.reason);
    };
    signal?.addEventListener("abort", stop, { once: true });
  });
}

/** Files of the placement at `base`; those that this browser keeps need no service, or stand in for one that does not answer. */
export function fetchFrom(base: string, traffic: Traffic, kept: KeptFiles | null = null): FetchBytes {
  const fetched = (name: string, signal?: AbortSignal, anew = false): Promise<Uint8Array | null> => fetchFile(base + name, traffic, signal, undefined, anew);
  if (!kept) return fetched;
  return async (name, signal, anew) => {
    const held = await kept.digestNamed(name);
    if (held) return held;
    try {
      const copy = await kept.get(name);
      const bytes = await (copy ? fetchOr(copy, base + name, traffic, signal) : fetched(name, signal, anew));
      const putting = bytes && bytes !== copy ? kept.put(name, bytes) : null;
      if (name === "manifest.json") await (bytes ? putting : kept.clear()); // before the files that it names
      return bytes;
    } catch (error) {
      if (error instanceof AccessDenied) await forgetFiles();
      throw error;
    }
  };
}

/** `copy` where there is no answer at all: one try, so that a page opens at once. */
async function fetchOr(copy: Uint8Array, url: string, traffic: Traffic, signal?: AbortSignal): Promise<Uint8Array | null> {
  try {
    return await timed(traffic, () => fetchOnce(url, false, traffic, signal));
  } catch (error) {
    if (signal?.aborted || !(error instanceof TypeError)) throw error;
    if (error instanceof Unwell) return fetchFile(url, traffic, signal);
    traffic.offline = true;
    return copy;
  }
}
