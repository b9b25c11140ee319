/**
 * Which controlled frames to measure: every cost varied on its own, none tied to another. Pure.
 *
 * Problem  The fit needs frames whose columns each vary by at least two and do not rise and fall together, on devices that
 *          differ by a hundred times in speed.
 * Method   The heaviest value of each column is found by doubling it, alone, until a frame takes `TARGET_MS` more than an empty one. Frames are then
 *          points of a Halton sequence, a dimension a column, squared: many light frames, few heavy ones. Some have no
 *          impostors, some no objects: they tell the constant of a frame from the rest.
 */
import type { DeviceProfile } from "../api/schema";

export interface Load {
  calls: number;
  triangles: number;
  pixels: number;
  impostors: number;
  impostor_triangles: number;
  impostor_pixels: number;
}

export interface Sample extends Load {
  ms: number;
}

export const COLUMNS = ["calls", "triangles", "pixels", "impostors", "impostor_triangles", "impostor_pixels"] as const;
export type Column = (typeof COLUMNS)[number];

export const TARGET_MS = 10;
export const FIRST: Load = { calls: 16, triangles: 2048, pixels: 20_000, impostors: 16, impostor_triangles: 64, impostor_pixels: 20_000 };
/** What no frame of the viewer comes near; memory has a say, too. */
export const MOST: Load = { calls: 4096, triangles: 4_194_304, pixels: 40_000_000, impostors: 2048, impostor_triangles: 65_536, impostor_pixels: 40_000_000 };
export const FRAMES = 180;
export const NOTHING: Load = { calls: 0, triangles: 0, pixels: 0, impostors: 0, impostor_triangles: 0, impostor_pixels: 0 };
const LARGEST = 2 * 256 * 256; // triangles of the largest mesh
const SCREENFUL = 500_000; // pixels that one mesh or layer covers at most
const PRIMES = [2, 3, 5, 7, 11, 13];
const SKIPPED = 20; // first points of a Halton sequence lie in order
const LEAST = 0.06;

export function halton(index: number, base: number): number {
  let [f, r] = [1, 0];
  for (let i = index; i > 0; i = Math.floor(i / base)) r += (f /= base) * (i % base);
  return r;
}

/** The frame that shows what one column costs: as little of the others as it can have. */
export function alone(column: Column, value: number): Load {
  const impostor = column.startsWith("impostor");
  const kind = impostor ? column.replace(/^impostor_/, "") : column;
  const n = kind === "calls" || kind === "impostors" ? value : kind === "pixels" ? Math.ceil(value / SCREENFUL) : impostor ? 1 : Math.ceil(value / LARGEST);
  const triangles = kind === "triangles" ? value : 2 * n;
  const pixels = kind === "pixels" ? value : 64;
  return impostor ? { ...NOTHING, impostors: n, impostor_triangles: triangles, impostor_pixels: pixels } : { ...NOTHING, calls: n, triangles, pixels };
}

/** The k-th frame to measure, of heaviest values `most`. */
export function frameAt(k: number, most: Load): Load {
  const value = (i: number): number => {
    const u = LEAST + (1 - LEAST) * halton(k + SKIPPED, PRIMES[i]);
    return Math.max(1, Math.round(most[COLUMNS[i]] * u * u));
  };
  const calls = value(0);
  const impostors = value(3);
  const bare = k % 11 === 5;
  const plain = k % 7 === 3;
  return {
    ...(bare ? { calls: 0, triangles: 0, pixels: 0 } : { calls, triangles: Math.max(2 * calls, value(1)), pixels: value(2) }),
    ...(plain ? { impostors: 0, impostor_triangles: 0, impostor_pixels: 0 } : { impostors, impostor_triangles: Math.max(2 * impostors, value(4)), impostor_pixels: value(5) }),
  };
}

/** Sides of meshes, as squares of a grid, two triangles each. */
export const SIDES = [1, 4, 16, 64, 256] as const;

/** How many of `calls` meshes have each side, so that all have about `triangles` together; never more calls. */
export function meshesFor(calls: number, triangles: number): number[] {
  const found = SIDES.map(() => 0);
  let [left, rest] = [calls, triangles - 2 * calls];
  for (let k = SIDES.length - 1; k > 0; k--) {
    const more = 2 * SIDES[k] * SIDES[k] - 2;
    found[k] = Math.min(left, Math.max(0, k === 1 ? Math.round(rest / more) : Math.floor(rest / more)));
    left -= found[k];
    rest -= found[k] * more;
  }
  found[0] = left;
  return found;
}

/** Width and height of a rectangle of about `area` pixels within a picture. */
export function rectangle(area: number, width: number, height: number): [number, number] {
  const h = Math.max(1, Math.min(height, Math.sqrt(area)));
  return [Math.max(1, Math.min(width, area / h)), h];
}

/** What a profile says of a frame: one that was measured, or the fit to all samples so far. */
export function predictedMs(load: Load, of: DeviceProfile): number {
  return (of.per_frame_ns + of.per_call_ns * load.calls + of.per_triangle_ns * load.triangles + of.per_pixel_ns * load.pixels
    + of.per_impostor_ns * load.impostors + of.per_impostor_triangle_ns * load.impostor_triangles + of.per_impostor_pixel_ns * load.impostor_pixels) / 1e6;
}
