/** Wire frames of what a placement speaks of: an impostor's view cell, the objects it replaces, a held cell with its interval. Pure. */
import type { PlacementIndex } from "../placementdb/index_file";
import type { Vec3 } from "../placementdb/manifest";
import { splitInterval } from "../select/intervals";
import { boxLines } from "./box_lines";

const SIDES = 24; // of a cone's circle
const RAYS = 8; // from its apex

/** Line ends, three numbers each, relative to the anchor; the anchor relative to origin_m. */
export interface Wires {
  ends: Float32Array;
  anchor: Vec3;
}

/** View cell of impostor `id` and the box of what it replaces. A shaft without an end is drawn `longest` metres long. */
export function impostorWires(index: PlacementIndex, id: number, longest: number): Wires {
  const cluster = index.impostorCluster[id];
  const replaced = index.clusterBox.slice(6 * cluster, 6 * cluster + 6);
  const cell = index.impostorViewCell.subarray(9 * id, 9 * id + 9);
  const anchor: Vec3 = [cell[0], cell[1], cell[2]];
  const parts = [boxLines(replaced, anchor)];
  if (index.impostorKind[id] === 0) parts.push(shaftLines(cell, longest));
  else parts.push(boxLines(cell.slice(0, 6), anchor));
  return { ends: joined(parts), anchor };
}

/** A cell's box, and the pyramid of directions of an interval from its middle, `length` metres far. */
export function heldWires(index: PlacementIndex, cell: number, interval: number, edges: ArrayLike<number>, length: number): Wires {
  const node = index.cellNode[cell];
  const box = index.nodeBox.slice(6 * node, 6 * node + 6);
  const anchor = [0, 1, 2].map((a) => (box[a] + box[3 + a]) / 2) as Vec3;
  return { ends: joined([boxLines(box, anchor), intervalLines(edges, interval, length)]), anchor };
}

/** From the apex (the anchor) along the axis from near to far: two circles and the rays between them. */
function shaftLines(cell: Float64Array, longest: number): Float32Array {
  const axis = [cell[3], cell[4], cell[5]];
  const [slope, near] = [cell[6], cell[7]];
  const far = Math.min(cell[8], near + longest);
  const least = axis.reduce((best, x, a) => (Math.abs(x) < Math.abs(axis[best]) ? a : best), 0);
  const aside = [0, 1, 2].map((a) => (a === least ? 1 : 0) - axis[least] * axis[a]);
  const length = Math.hypot(aside[0], aside[1], aside[2]);
  const u = aside.map((x) => x / length);
  const v = [axis[1] * u[2] - axis[2] * u[1], axis[2] * u[0] - axis[0] * u[2], axis[0] * u[1] - axis[1] * u[0]];
  const point = (distance: number, k: number): number[] => {
    const [c, s] = [Math.cos((2 * Math.PI * k) / SIDES), Math.sin((2 * Math.PI * k) / SIDES)];
    return axis.map((x, a) => distance * (x + slope * (c * u[a] + s * v[a])));
  };
  const out: number[] = [];
  for (let k = 0; k < SIDES; k++) {
    for (const distance of [near, far]) out.push(...point(distance, k), ...point(distance, k + 1));
    if (k % (SIDES / RAYS) === 0) out.push(...point(near, k), ...point(far, k));
  }
  return Float32Array.from(out);
}

function intervalLines(edges: ArrayLike<number>, interval: number, length: number): Float32Array {
  const { face, i, j } = splitInterval(interval, edges.length - 1);
  const m = face >> 1;
  const corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(([a, b]) => {
    const d = [0, 0, 0];
    d[m] = face % 2 ? -1 : 1;
    d[(m + 1) % 3] = edges[i + a];
    d[(m + 2) % 3] = edges[j + b];
    const scale = length / Math.hypot(d[0], d[1], d[2]);
    return d.map((x) => x * scale);
  });
  return Float32Array.from(corners.flatMap((corner, k) => [0, 0, 0, ...corner, ...corner, ...corners[(k + 1) % 4]]));
}

function joined(parts: Float32Array[]): Float32Array {
  const out = new Float32Array(parts.reduce((n, part) => n + part.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}
