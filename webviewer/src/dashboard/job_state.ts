/**
 * What is known of a job's shards and log: a snapshot, moved on by events. Pure; events may come twice or overlap the
 * snapshot, each says what is so and not what has changed.
 */
import type { JobEvent, ShardKind, ShardRow, ShardState } from "../api/types";
import { bytes } from "../ui/format";
import { plural, sentences } from "./format";

export interface Shard {
  state: ShardState;
  attempt: number;
  cached: boolean;
  seconds: number | null;
  peakBytes: number | null;
  worker: string | null;
  sinceMs: number | null; // when it began to run
  error: string | null;
}

export type Level = "info" | "warn" | "error";

export interface LogLine {
  seq: number;
  atMs: number;
  level: Level;
  stage: string;
  who: string;
  text: string;
}

export interface JobState {
  /** Stage -> kind -> shards by place. */
  shards: Map<string, Map<ShardKind, Shard[]>>;
  log: LogLine[];
  lastEvent: number;
}

export const MOST_LINES = 5000;

export function emptyState(): JobState {
  return { shards: new Map(), log: [], lastEvent: 0 };
}

/** A stage of more shards tells of its progress only: see the service's store/shards.py. */
const MOST_LISTED = 5000;

function blank(): Shard {
  return { state: "ready", attempt: 0, cached: false, seconds: null, peakBytes: null, worker: null, sinceMs: null, error: null };
}

function listOf(state: JobState, stage: string, kind: ShardKind): Shard[] {
  let kinds = state.shards.get(stage);
  if (!kinds) state.shards.set(stage, (kinds = new Map()));
  let list = kinds.get(kind);
  if (!list) kinds.set(kind, (list = []));
  return list;
}

/** The shards of a stage as the service has them now. */
export function setShards(state: JobState, stage: string, rows: readonly ShardRow[]): void {
  const before = state.shards.get(stage);
  state.shards.delete(stage);
  for (const row of rows) {
    const since = before?.get(row.kind)?.[row.ordinal]?.sinceMs ?? null;
    listOf(state, stage, row.kind)[row.ordinal] = {
      state: row.state, attempt: row.attempt, cached: row.cached, seconds: row.seconds, peakBytes: row.peak_bytes,
      worker: row.worker, sinceMs: since, error: row.error?.message ?? null,
    };
  }
}

/** Takes in an event; returns whether stages or the job itself changed, and should be read again. */
export function apply(state: JobState, event: JobEvent): boolean {
  if (event.seq > state.lastEvent) {
    state.lastEvent = event.seq;
    addLine(state, event);
  }
  if (event.kind === "progress") return false;
  const { stage, kind, ordinal } = event.data;
  if (event.kind === "shard" && stage && kind && ordinal !== undefined) {
    const list = listOf(state, stage, kind);
    const shard = (list[ordinal] ??= blank());
    shard.state = (event.data.state ?? shard.state) as ShardState;
    shard.attempt = event.data.attempt ?? shard.attempt;
    if (shard.state === "running") shard.sinceMs = Date.parse(event.at);
    if (event.data.seconds !== undefined) shard.seconds = event.data.seconds;
    if (event.data.cached !== undefined) shard.cached = event.data.cached;
    if (event.data.error) shard.error = event.data.error.message ?? null;
    return kind !== "run";
  }
  if (event.kind === "stage" && stage && event.data.shards !== undefined) {
    const list = listOf(state, stage, "run");
    for (let k = 0; k < Math.min(event.data.shards, MOST_LISTED); k++) list[k] ??= blank();
  }
  if (event.kind === "job" && (event.data.state === "cancelled" || event.data.state === "failed")) drop(state);
  return event.kind !== "shard";
}

/** Lines of events that happened before the snapshot: for the log alone. */
export function addHistory(state: JobState, events: readonly JobEvent[]): void {
  for (const event of events) addLine(state, event);
  state.log.sort((a, b) => a.seq - b.seq);
  state.lastEvent = Math.max(state.lastEvent, ...events.map((e) => e.seq));
}

function drop(state: JobState): void {
  for (const kinds of state.shards.values()) {
    for (const list of kinds.values()) {
      for (const shard of list) if (shard && (shard.state === "ready" || shard.state === "running")) shard.state = "cancelled";
    }
  }
}

function addLine(state: JobState, event: JobEvent): void {
  if (event.data.map) return; // told by the map
  state.log.push(lineOf(event));
  if (state.log.length > MOST_LINES) state.log.splice(0, state.log.length - MOST_LINES);
}

const KIND_WORD: Record<ShardKind, string> = { run: "", plan: "plan", merge: "merge", report: "report" };

export function lineOf(event: JobEvent): LogLine {
  const d = event.data;
  const line: LogLine = { seq: event.seq, atMs: Date.parse(event.at), level: "info", stage: d.stage ?? "", who: "job", text: d.state ?? event.kind };
  const why = sentences(d.error?.message, d.error?.advice);
  if (event.kind === "shard") {
    line.who = `${d.stage ?? ""} ${d.kind && d.kind !== "run" ? KIND_WORD[d.kind] : String((d.ordinal ?? 0) + 1)}`;
    if (d.state === "running") line.text = (d.attempt ?? 1) > 1 ? `attempt ${d.attempt}` : "started";
    else if (d.state === "done") line.text = d.cached ? "known already, taken over" : `done, ${(d.seconds ?? 0).toFixed(1)} s`;
    else if (d.state === "ready") line.text = `failed, will be tried again: ${why}`;
    else if (d.state === "failed") line.text = `failed: ${why}`;
    line.level = d.state === "failed" ? "error" : d.state === "ready" || (d.attempt ?? 1) > 1 ? "warn" : "info";
  } else if (event.kind === "progress") {
    line.who = d.stage ?? "";
    line.text = [d.choices !== undefined ? plural(d.choices, "choice") : d.impostors !== undefined ? plural(d.impostors, "impostor") : "",
      d.bytes !== undefined ? bytes(d.bytes) : "", d.unsolved !== undefined ? `${plural(d.unsolved, "view")} unsolved` : ""].filter(Boolean).join(", ");
  } else if (event.kind === "stage") {
    line.who = d.stage ?? "";
    if (d.state === "skipped") line.text = `skipped: ${d.skipped ?? ""}`;
    else if (d.state === "running" && d.done !== undefined) line.text = `${d.done} of ${d.shards} shards done`;
    else if (d.state === "running" && d.shards !== undefined) line.text = `runs in ${d.shards} shard${d.shards === 1 ? "" : "s"}`;
    else if (d.state === "failed") line.level = "error";
  } else if (d.state === "failed") {
    line.level = "error";
    line.text = `failed: ${why}`;
  } else if (d.state === "done") {
    line.text = `done: ${d.verdict ?? "no verdict"}`;
  }
  return line;
}

/** What one square of the grid stands for: worst state first. */
const WORST: readonly ShardState[] = ["failed", "running", "ready", "cancelled", "done"];
const RANK = Object.fromEntries(WORST.map((state, k) => [state, k])) as Record<ShardState, number>;
export const MOST_SQUARES = 2000;

export interface Square {
  state: ShardState;
  retried: boolean;
  first: number;
  count: number;
}

/** At most `most` squares; past that each stands for a block and shows its worst state. */
export function squares(list: readonly (Shard | undefined)[], most = MOST_SQUARES): Square[] {
  const block = Math.ceil(list.length / most) || 1;
  const found: Square[] = [];
  for (let at = 0; at < list.length; at += block) {
    const stop = Math.min(list.length, at + block);
    let [worst, retried] = [WORST.length - 1, false];
    for (let k = at; k < stop; k++) {
      const shard = list[k];
      worst = Math.min(worst, RANK[shard?.state ?? "ready"]);
      retried ||= shard !== undefined && shard.attempt > 1;
    }
    found.push({ state: WORST[worst], retried, first: at, count: stop - at });
  }
  return found;
}
