/**
 * What a running optimiser tells of itself (workers/farfield_workers/news.py): curves, and the view space as tiles. Pure.
 * Several shards may choose at once, a region each: their numbers add up; the merge that follows begins anew.
 */
import type { JobEvent, LiveMap } from "../api/types";

export interface LivePoint {
  atMs: number;
  bytes: number;
  unsolved: number; // of the problem views: above their target, or hopeless
}

export interface Live {
  map: LiveMap | null;
  points: LivePoint[];
  hopeless: number;
  smallestBudget: number | null; // in the map's unit
  /** Unsolved views of each tile; null until somebody said. */
  tiles: number[] | null;
  /** Of each shard that chooses: what it said last. */
  shards: Map<string, Said>;
}

interface Said {
  bytes: number;
  hopeless: number;
  tiles: Map<number, number>;
}

export function emptyLive(): Live {
  return { map: null, points: [], hopeless: 0, smallestBudget: null, tiles: null, shards: new Map() };
}

/** Takes in an event "progress"; false where it is none. */
export function takeLive(live: Live, event: JobEvent): boolean {
  if (event.kind !== "progress") return false;
  const d = event.data;
  if (d.map) {
    const views = d.map.views.map((n, k) => Math.max(n, live.map?.views[k] ?? 0)); // a region tells of its own views
    live.map = { ...d.map, views };
    return true;
  }
  if (d.kind === "merge" && ![...live.shards.keys()].some((key) => key.startsWith("merge"))) live.shards.clear();
  const key = `${d.kind} ${d.ordinal}`;
  let said = live.shards.get(key);
  if (!said || d.first) live.shards.set(key, (said = { bytes: 0, hopeless: 0, tiles: new Map() }));
  if (d.bytes !== undefined) said.bytes = d.bytes;
  if (d.hopeless !== undefined) said.hopeless = d.hopeless;
  if (d.smallest_budget !== undefined) live.smallestBudget = d.smallest_budget;
  for (const [k, n] of d.tiles ?? []) said.tiles.set(k, n);
  const all = [...live.shards.values()];
  live.hopeless = all.reduce((sum, s) => sum + s.hopeless, 0);
  if (live.map) {
    live.tiles = new Array<number>(live.map.cost.length).fill(0);
    for (const s of all) for (const [k, n] of s.tiles) live.tiles[k] += n;
  }
  const unsolved = all.reduce((sum, s) => [...s.tiles.values()].reduce((n, m) => n + m, sum), 0);
  live.points.push({ atMs: Date.parse(event.at), bytes: all.reduce((sum, s) => sum + s.bytes, 0), unsolved });
  return true;
}

/** Up to about `wanted` round steps from 0 that cover `most`. */
export function ticks(most: number, wanted = 3): number[] {
  if (!(most > 0)) return [0, 1];
  const raw = most / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw)!;
  return Array.from({ length: Math.ceil(most / step - 1e-9) + 1 }, (_, k) => k * step);
}
