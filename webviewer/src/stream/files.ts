/** Files over HTTP: retried with backoff while wanted, cancelled by signal, counted for the streaming panel. */
import type { FetchBytes } from "../placementdb/placement";

export class AccessDenied extends Error {
  constructor() {
    super("This placement belongs to another account, or the session has ended: sign in again.");
  }
}

export interface Traffic {
  bytes: number; // received in all
  failures: number; // in a row; 0 while the connection works
  retryAtMs: number;
}

export function makeTraffic(): Traffic {
  return { bytes: 0, failures: 0, retryAtMs: 0 };
}

const BACKOFF_MS = [500, 1000, 2000, 4000, 8000];
const MOST_TRIES_ON_5XX = 6;

/** Resolves to null for 404. A lost connection is retried for ever, a failing server six times. */
export async function fetchFile(url: string, traffic: Traffic, signal?: AbortSignal, onBytes?: (got: number, total: number) => void): Promise<Uint8Array | null> {
  for (let attempt = 0; ; attempt++) {
    try {
      const response = await fetch(url, signal ? { signal, credentials: "same-origin" } : { credentials: "same-origin" });
      if (response.status === 404) return null;
      if (response.status === 401 || response.status === 403) throw new AccessDenied();
      if (!response.ok) {
        if (response.status < 500 && response.status !== 429) throw new Error(`${url} answered ${response.status}`);
        if (attempt + 1 >= MOST_TRIES_ON_5XX) throw new AccessFailed(url, response.status);
        throw new TypeError(`status ${response.status}`);
      }
      const bytes = await readBody(response, traffic, onBytes);
      traffic.failures = 0;
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

export function fetchFrom(base: string, traffic: Traffic): FetchBytes {
  return (name, signal) => fetchFile(base + name, traffic, signal);
}
