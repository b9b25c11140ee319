/**
 * Covered pixels as the cost model counts them (services/farfield/rendertime/cost.py): the part of a box or polygon
 * inside the view pyramid, projected; of a box the bounding rectangle, of a polygon its area. No allocation.
 */
import type { Frustum } from "./frustum";

const MAX_CORNERS = 16;
let from = new Float64Array(3 * MAX_CORNERS);
let into = new Float64Array(3 * MAX_CORNERS);
const FACES = [
  [0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3],
] as const;
const corner = new Float64Array(24); // (8,3) right, up, forward

/** Bounding rectangle of a box's visible part on a screen of width x height pixels; `at` points at low, high. */
export function boxPixels(fr: Frustum, boxes: ArrayLike<number>, at: number, width: number, height: number): number {
  let inside = true;
  for (let k = 0; k < 8; k++) {
    const x = boxes[at + (k & 4 ? 3 : 0)] - fr.eye[0];
    const y = boxes[at + (k & 2 ? 4 : 1)] - fr.eye[1];
    const z = boxes[at + (k & 1 ? 5 : 2)] - fr.eye[2];
    inside = toCamera(fr, x, y, z, corner, 3 * k) && inside;
  }
  bounds[0] = bounds[1] = Infinity;
  bounds[2] = bounds[3] = -Infinity;
  if (inside) {
    for (let k = 0; k < 8; k++) grow(corner[3 * k] / corner[3 * k + 2], corner[3 * k + 1] / corner[3 * k + 2]);
  } else {
    if (holdsEye(fr, boxes, at)) return width * height;
    for (const face of FACES) {
      for (let c = 0; c < 4; c++) from.set(corner.subarray(3 * face[c], 3 * face[c] + 3), 3 * c);
      const n = clip(4, fr.tanX, fr.tanY);
      for (let c = 0; c < n; c++) {
        const z = from[3 * c + 2];
        if (z > 0) grow(from[3 * c] / z, from[3 * c + 1] / z);
      }
    }
  }
  if (!(bounds[2] >= bounds[0])) return 0;
  const w = (Math.min(bounds[2], fr.tanX) - Math.max(bounds[0], -fr.tanX)) / (2 * fr.tanX);
  const h = (Math.min(bounds[3], fr.tanY) - Math.max(bounds[1], -fr.tanY)) / (2 * fr.tanY);
  return Math.max(0, w) * Math.max(0, h) * width * height;
}

/** Area of a convex polygon's visible part; its n <= 8 points (relative to the eye) stand in `points` from `at`. */
export function polygonPixels(fr: Frustum, points: ArrayLike<number>, at: number, n: number, width: number, height: number): number {
  for (let c = 0; c < n; c++) toCamera(fr, points[at + 3 * c], points[at + 3 * c + 1], points[at + 3 * c + 2], from, 3 * c);
  const m = clip(n, fr.tanX, fr.tanY);
  let area = 0;
  for (let c = 0; c < m; c++) {
    const d = (c + 1) % m;
    const zc = from[3 * c + 2];
    const zd = from[3 * d + 2];
    if (!(zc > 0 && zd > 0)) return width * height;
    area += (from[3 * c] / zc) * (from[3 * d + 1] / zd) - (from[3 * d] / zd) * (from[3 * c + 1] / zc);
  }
  return (Math.abs(area) / 2 / (4 * fr.tanX * fr.tanY)) * width * height;
}

const bounds = new Float64Array(4);

function grow(x: number, y: number): void {
  bounds[0] = Math.min(bounds[0], x);
  bounds[1] = Math.min(bounds[1], y);
  bounds[2] = Math.max(bounds[2], x);
  bounds[3] = Math.max(bounds[3], y);
}

/** Writes right, up, forward of a point relative to the eye; returns whether it lies in the pyramid. */
function toCamera(fr: Frustum, x: number, y: number, z: number, out: Float64Array, at: number): boolean {
  const a = fr.right[0] * x + fr.right[1] * y + fr.right[2] * z;
  const b = fr.up[0] * x + fr.up[1] * y + fr.up[2] * z;
  const c = fr.forward[0] * x + fr.forward[1] * y + fr.forward[2] * z;
  out[at] = a;
  out[at + 1] = b;
  out[at + 2] = c;
  return c > 0 && Math.abs(a) <= fr.tanX * c && Math.abs(b) <= fr.tanY * c;
}

function holdsEye(fr: Frustum, boxes: ArrayLike<number>, at: number): boolean {
  for (let a = 0; a < 3; a++) if (!(boxes[at + a] <= fr.eye[a] && fr.eye[a] <= boxes[at + 3 + a])) return false;
  return true;
}

/** Clips the polygon in `from` against the four sides (Sutherland and Hodgman); the result is in `from` again. */
function clip(n: number, tanX: number, tanY: number): number {
  for (let side = 0; side < 4 && n > 0; side++) {
    const axis = side >> 1;
    const sign = side & 1 ? -1 : 1;
    const tan = axis === 0 ? tanX : tanY;
    let m = 0;
    for (let c = 0; c < n; c++) {
      const d = c + 1 === n ? 0 : c + 1;
      const here = tan * from[3 * c + 2] + sign * from[3 * c + axis];
      const there = tan * from[3 * d + 2] + sign * from[3 * d + axis];
      if (here >= 0) {
        into.set(from.subarray(3 * c, 3 * c + 3), 3 * m);
        m++;
      }
      if (here >= 0 !== there >= 0) {
        const t = here / (here - there);
        for (let a = 0; a < 3; a++) into[3 * m + a] = from[3 * c + a] + t * (from[3 * d + a] - from[3 * c + a]);
        m++;
      }
    }
    [from, into] = [into, from];
    n = m;
  }
  return n;
}
