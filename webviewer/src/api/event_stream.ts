/**
 * Server-sent events over fetch, resumed by number. EventSource can do neither of what the pages need: say since when
 * the line has been dead and when the next attempt is, and tell an ended session from a lost connection.
 */
import { addressOf, problemOf } from "./client";
import type { EventData, JobEvent } from "./types";

export interface Frame {
  id: string;
  event: string;
  data: string;
}

/** Cuts a text stream into frames; pieces may end anywhere. HTML Living Standard, 9.2.6. */
export class FrameParser {
  private rest = "";
  private fields: { id: string; event: string; data: string[] } = { id: "", event: "", data: [] };

  push(text: string): Frame[] {
    const found: Frame[] = [];
    // A trailing CR may be half of a CRLF: it waits for the next piece.
    const lines = (this.rest + text).split(/\r\n|\n|\r(?!$)/);
    this.rest = lines.pop() ?? "";
    for (const line of lines) {
      if (line === "") {
        if (this.fields.data.length) found.push({ id: this.fields.id, event: this.fields.event || "message", data: this.fields.data.join("\n") });
        this.fields = { id: this.fields.id, event: "", data: [] };
        continue;
      }
      const colon = line.indexOf(":");
      if (colon === 0) continue;
      const name = colon < 0 ? line : line.slice(0, colon);
      const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
      if (name === "data") this.fields.data.push(value);
      else if (name === "event") this.fields.event = value;
      else if (name === "id" && !value.includes("\0")) this.fields.id = value;
    }
    return found;
  }
}

const BACKOFF_MS = [500, 1000, 2000, 4000, 8000];
const SILENCE_MS = 40_000; // the service sends a comment at least every 15 s

/** Wait before attempt n (from 0), spread by up to a fifth so that a restart is not met by all pages at once. */
export function backoffMs(attempt: number, random: number): number {
  return BACKOFF_MS[Math.min(attempt, BACKOFF_MS.length - 1)] * (1 + random / 5);
}

export type Line =
  | { state: "live" }
  | { state: "lost"; sinceMs: number; retryAtMs: number; lastEvent: number }
  | { state: "ended" } // the job has ended and all was seen
  | { state: "refused"; error: Error };

export interface Listener {
  event: (event: JobEvent) => void;
  line: (line: Line) => void;
}

/** Follows a job's events above `after` until it ends. */
export class EventStream {
  private last: number;
  private attempt = 0;
  private lostAtMs = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private abort: AbortController | null = null;
  private closed = false;
  private readonly job: string;
  private readonly listener: Listener;

  constructor(job: string, after: number, listener: Listener) {
    this.job = job;
    this.last = after;
    this.listener = listener;
    void this.connect();
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    this.abort?.abort();
  }

  retryNow(): void {
    if (this.closed || this.timer === undefined) return;
    clearTimeout(this.timer);
    void this.connect();
  }

  private async connect(): Promise<void> {
    this.timer = undefined;
    const abort = (this.abort = new AbortController());
    try {
      const response = await fetch(addressOf("GET /v1/jobs/{job_id}/events", { job_id: this.job }), {
        headers: { accept: "text/event-stream", "last-event-id": String(this.last) },
        credentials: "same-origin",
        cache: "no-store",
        signal: abort.signal,
      });
      if (response.status === 204) return this.end();
      if (!response.ok) {
        const problem = await problemOf(response);
        if (response.status < 500 && response.status !== 429) {
          this.closed = true;
          this.listener.line({ state: "refused", error: problem });
          return;
        }
        throw problem;
      }
      this.listener.line({ state: "live" });
      await this.read(response, abort);
    } catch {
      // Any failure of the line is answered alike: wait, then resume after the last event seen.
    }
    if (!this.closed) this.wait();
  }

  private async read(response: Response, abort: AbortController): Promise<void> {
    const reader = response.body!.pipeThrough(new TextDecoderStream() as unknown as ReadableWritablePair<string, Uint8Array<ArrayBuffer>>).getReader();
    const parser = new FrameParser();
    for (;;) {
      const silence = setTimeout(() => abort.abort(), SILENCE_MS);
      const { done, value } = await reader.read().finally(() => clearTimeout(silence));
      if (done || this.closed) return;
      this.attempt = 0;
      for (const frame of parser.push(value)) {
        const { at, ...data } = JSON.parse(frame.data) as EventData & { at: string };
        this.last = Number(frame.id);
        this.listener.event({ seq: this.last, kind: frame.event as JobEvent["kind"], data, at });
      }
    }
  }

  private end(): void {
    this.closed = true;
    this.listener.line({ state: "ended" });
  }

  private wait(): void {
    const now = Date.now();
    if (this.attempt === 0) this.lostAtMs = now;
    const ms = backoffMs(this.attempt++, Math.random());
    this.timer = setTimeout(() => void this.connect(), ms);
    this.listener.line({ state: "lost", sinceMs: this.lostAtMs, retryAtMs: now + ms, lastEvent: this.last });
  }
}
