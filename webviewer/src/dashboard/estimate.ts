/**
 * How far a job is, and how long it still takes: a range, with what it rests on, or nothing.
 *
 * Rest of the running stage: seconds so far x shards left / shards done, give or take 1 / sqrt(shards done). Nothing is
 * said before a shard has finished; a stage of one shard rests on earlier jobs alone.
 * Later stages: what earlier jobs took for them, scaled by how much slower or faster this job was so far; the range is
 * their least and most. Without an earlier job only the running stage is estimated, and the text says so.
 */
import type { StageRow } from "../api/types";

export interface Estimate {
  /** Share done, 0..1, and where the stages end on the same scale. */
  fraction: number;
  ends: number[];
  /** Seconds left; null: not known yet. `later` stages are not in it. */
  left: { low: number; high: number; later: number } | null;
  basis: string;
}

/** Stage -> seconds, of a job that is done. */
export type History = Record<string, number>;

export function historyOf(stages: readonly StageRow[]): History {
  return Object.fromEntries(stages.map((s) => [s.name, s.seconds ?? 0]));
}

const ENDED = ["done", "skipped", "failed"];
const LEAST_SHARE = 0.02; // of the bar, so that a short stage can still be seen
const ALONE = 0.5; // how far off a single earlier job may be

export function estimate(stages: readonly StageRow[], histories: readonly History[]): Estimate {
  const shares = sharesOf(stages, histories);
  const ends: number[] = [];
  let before = 0;
  let fraction = 0;
  stages.forEach((s, k) => {
    const part = isEnded(s) ? 1 : s.shards.total ? s.shards.done / s.shards.total : 0;
    fraction += shares[k] * part;
    before += shares[k];
    if (isEnded(s)) ends.push(Math.min(before, 1));
  });
  const at = stages.findIndex((s) => !isEnded(s));
  if (at < 0) return { fraction: 1, ends, left: { low: 0, high: 0, later: 0 }, basis: "" };
  return { fraction: Math.min(fraction, 1), ends, ...timeLeft(stages, at, histories) };
}

function isEnded(s: StageRow): boolean {
  return ENDED.includes(s.state);
}

function sharesOf(stages: readonly StageRow[], histories: readonly History[]): number[] {
  if (!histories.length) return stages.map(() => 1 / stages.length);
  const raw = stages.map((s) => {
    const parts = histories.map((h) => (h[s.name] ?? 0) / Math.max(total(h), 1e-9));
    return Math.max(LEAST_SHARE, parts.reduce((a, b) => a + b, 0) / parts.length);
  });
  const sum = raw.reduce((a, b) => a + b, 0);
  return raw.map((x) => x / sum);
}

function total(h: History): number {
  return Object.values(h).reduce((a, b) => a + b, 0);
}

function timeLeft(stages: readonly StageRow[], at: number, histories: readonly History[]): Pick<Estimate, "left" | "basis"> {
  const now = stages[at];
  const { total: n, done } = now.shards;
  const known = stages.slice(0, at).filter((s) => s.state === "done" && (s.seconds ?? 0) > 0);
  const paces = histories.map((h) => pace(known, h));
  const single = n === 1 && histories.length > 0;
  if (now.state !== "running" && now.state !== "merging" && now.state !== "reporting" && !single) {
    return { left: null, basis: now.state === "waiting" ? "waits for a worker" : `${now.name} is being planned` };
  }
  let low: number;
  let high: number;
  if (single && done === 0) {
    const rests = histories.map((h, k) => Math.max(0, (h[now.name] ?? 0) * paces[k] - (now.seconds ?? 0)));
    [low, high] = span(rests);
  } else if (done === 0) {
    return { left: null, basis: n > 1 ? `the first of ${n} shards of ${now.name} runs` : `${now.name} runs in one piece` };
  } else {
    const rest = ((now.seconds ?? 0) * (n - done)) / done;
    const off = Math.min(0.6, Math.max(0.1, 1 / Math.sqrt(done)));
    [low, high] = [rest * (1 - off), rest * (1 + off)];
  }
  const later = stages.length - at - 1;
  const basis = n > 1 ? `from ${done.toLocaleString("en")} of ${n.toLocaleString("en")} shards` : "";
  if (!histories.length) return { left: { low, high, later }, basis };
  const rests = histories.map((h, k) => stages.slice(at + 1).reduce((sum, s) => sum + (h[s.name] ?? 0), 0) * paces[k]);
  const [lowLater, highLater] = span(rests);
  const jobs = histories.length === 1 ? "an earlier job" : `${histories.length} earlier jobs`;
  return { left: { low: low + lowLater, high: high + highLater, later: 0 }, basis: basis ? `${basis} and ${jobs}` : `from ${jobs}` };
}

/** How many times longer this job takes than that one, by the stages that it has behind it. */
function pace(known: readonly StageRow[], h: History): number {
  const ours = known.reduce((sum, s) => sum + (s.seconds ?? 0), 0);
  const theirs = known.reduce((sum, s) => sum + (h[s.name] ?? 0), 0);
  return ours > 1 && theirs > 1 ? Math.min(20, Math.max(0.05, ours / theirs)) : 1;
}

function span(values: number[]): [number, number] {
  const low = Math.min(...values);
  const high = Math.max(...values);
  return values.length > 1 ? [low * 0.9, high * 1.1] : [low * (1 - ALONE), high * (1 + ALONE)];
}

/** A bar never runs backwards: the largest fraction seen of each job. */
export class Ratchet {
  private readonly seen = new Map<string, number>();
  at(job: string, fraction: number): number {
    const found = Math.max(fraction, this.seen.get(job) ?? 0);
    this.seen.set(job, found);
    return found;
  }
}
