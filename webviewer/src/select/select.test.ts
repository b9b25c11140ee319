import { describe, expect, it } from "vitest";
import { findCell } from "./cells";
import { clampToBoxes, insideBoxes } from "./clamp";
import { boxInside, boxMeets, cameraFrame, makeFrustum, setFrustum, type Frustum } from "./frustum";
import { findInterval, splitInterval } from "./intervals";
import { boxPixels, polygonPixels } from "./pixels";
import type { Box, Vec3 } from "../placementdb/manifest";

function random(seed: number): () => number {
  let s = seed >>> 0;
  return () => {
    s = (Math.imul(s, 1664525) + 1013904223) >>> 0;
    let t = s ^ (s >>> 15);
    t = Math.imul(t, 0x2c1b3c6d);
    return ((t ^ (t >>> 13)) >>> 0) / 2 ** 32;
  };
}

function randomFrustum(next: () => number): Frustum {
  const eye: Vec3 = [next() * 10 - 5, next() * 10 - 5, next() * 10 - 5];
  // A third of the cameras look along an axis: degenerate cross products.
  const d: Vec3 = next() < 0.33 ? [[1, 0, 0], [0, 0, -1], [0, 1, 0], [0, -1, 0]][Math.floor(next() * 4)] as Vec3 : [next() - 0.5, next() - 0.5, next() - 0.5];
  return setFrustum(makeFrustum(), cameraFrame(eye, d), 20 + 80 * next(), 0.5 + 2 * next());
}

function randomBox(next: () => number): Float64Array {
  const box = new Float64Array(6);
  for (let a = 0; a < 3; a++) {
    const size = next() < 0.2 ? 0 : next() * (next() < 0.1 ? 60 : 4);
    box[a] = next() * 40 - 20 - size / 2;
    box[3 + a] = box[a] + size;
  }
  return box;
}

/** The slow obvious version: least violation of the four sides over the box, by bisection-free linear programming in 3D
 * is more than is needed; clipping every face and asking for anything left, or the axis ray through the box, is exact. */
function naiveMeets(fr: Frustum, box: Float64Array): { meets: boolean; margin: number } {
  const tests = [fr.forward, ...[-1, 1].flatMap((x) => [-1, 1].map((y) => [0, 1, 2].map((a) => fr.forward[a] + x * fr.tanX * fr.right[a] + y * fr.tanY * fr.up[a]) as Vec3))];
  if (tests.some((d) => rayHits(fr.eye, d, box))) return { meets: true, margin: Infinity };
  const corners = [...Array(8).keys()].map((k) => [box[k & 1 ? 3 : 0], box[k & 2 ? 4 : 1], box[k & 4 ? 5 : 2]].map((x, a) => x - fr.eye[a]));
  const depth = (p: number[]): number[] => {
    const [x, y, z] = [fr.right, fr.up, fr.forward].map((v) => v[0] * p[0] + v[1] * p[1] + v[2] * p[2]);
    return [fr.tanX * z - x, fr.tanX * z + x, fr.tanY * z - y, fr.tanY * z + y];
  };
  let best = -Infinity; // largest, over points of the box's edges, of the least signed distance to the four sides
  for (let k = 0; k < 8; k++) {
    for (const bit of [1, 2, 4]) {
      if (k & bit) continue;
      const a = depth(corners[k]);
      const b = depth(corners[k | bit]);
      // min of four linear functions of t in [0,1] is concave: its maximum is at an end or where two of them cross.
      const ts = [0, 1];
      for (let i = 0; i < 4; i++) for (let j = 0; j < i; j++) {
        const t = (a[i] - a[j]) / (a[i] - a[j] - (b[i] - b[j]));
        if (t > 0 && t < 1) ts.push(t);
      }
      for (const t of ts) best = Math.max(best, Math.min(...a.map((x, i) => x + t * (b[i] - x))));
    }
  }
  return { meets: best >= 0, margin: Math.abs(best) };
}

function rayHits(eye: Vec3, d: Vec3, box: Float64Array): boolean {
  let t0 = 0;
  let t1 = Infinity;
  for (let a = 0; a < 3; a++) {
    const low = box[a] - eye[a];
    const high = box[3 + a] - eye[a];
    if (d[a] === 0) {
      if (low > 0 || high < 0) return false;
      continue;
    }
    t0 = Math.max(t0, Math.min(low / d[a], high / d[a]));
    t1 = Math.min(t1, Math.max(low / d[a], high / d[a]));
  }
  return t0 <= t1;
}

describe("boxes against the view pyramid", () => {
  it("agrees with rays through the box and the box's edges in the pyramid", () => {
    const next = random(1);
    let met = 0;
    let missed = 0;
    for (let k = 0; k < 4000; k++) {
      const fr = randomFrustum(next);
      for (let b = 0; b < 4; b++) {
        const box = randomBox(next);
        const expected = naiveMeets(fr, box);
        if (expected.margin < 1e-9) continue;
        expect(boxMeets(fr, box, 0), `${Array.from(box)} ${fr.eye} ${fr.forward}`).toBe(expected.meets);
        if (expected.meets) met++;
        else missed++;
      }
    }
    expect(met).toBeGreaterThan(1500);
    expect(missed).toBeGreaterThan(1500);
  });

  it("finds whole boxes inside only when all corners are, and a box around the eye always", () => {
    const next = random(2);
    for (let k = 0; k < 2000; k++) {
      const fr = randomFrustum(next);
      const box = randomBox(next);
      if (boxInside(fr, box, 0)) expect(boxMeets(fr, box, 0)).toBe(true);
      const around = Float64Array.from([0, 1, 2, 0, 1, 2], (a, i) => fr.eye[a] + (i < 3 ? -next() : next()));
      expect(boxMeets(fr, around, 0)).toBe(true);
    }
  });

  it("keeps every box that holds a point of the picture", () => {
    const next = random(3);
    for (let k = 0; k < 5000; k++) {
      const fr = randomFrustum(next);
      const x = (2 * next() - 1) * fr.tanX;
      const y = (2 * next() - 1) * fr.tanY;
      const z = next() * 30;
      const p = [0, 1, 2].map((a) => fr.eye[a] + z * (fr.forward[a] + x * fr.right[a] + y * fr.up[a]));
      const box = Float64Array.from([0, 1, 2, 0, 1, 2], (a, i) => p[a] + (i < 3 ? -next() : next()) * 0.3);
      expect(boxMeets(fr, box, 0)).toBe(true);
    }
  });
});

describe("covered pixels", () => {
  it("of a box are the bounding rectangle of what a raster of rays through the screen hits", () => {
    const next = random(4);
    for (let k = 0; k < 150; k++) {
      const fr = randomFrustum(next);
      const box = randomBox(next);
      const n = 60;
      const rectangle = (of: Float64Array): [number, number] => {
        let [x0, x1, y0, y1] = [n, -1, n, -1];
        for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
          const sx = ((2 * i + 1) / n - 1) * fr.tanX;
          const sy = ((2 * j + 1) / n - 1) * fr.tanY;
          if (!rayHits(fr.eye, [0, 1, 2].map((a) => fr.forward[a] + sx * fr.right[a] + sy * fr.up[a]) as Vec3, of)) continue;
          [x0, x1, y0, y1] = [Math.min(x0, i), Math.max(x1, i), Math.min(y0, j), Math.max(y1, j)];
        }
        return [Math.max(0, x1 - x0 + 1), Math.max(0, y1 - y0 + 1)];
      };
      const measured = boxPixels(fr, box, 0, n, n);
      const [w, h] = rectangle(box);
      expect(measured).toBeGreaterThanOrEqual(Math.max(0, w - 1) * Math.max(0, h - 1) - 1e-9);
      // Slivers fall between rays; a box grown by a pixel at its farthest point cannot.
      const reach = Math.hypot(...[0, 1, 2].map((a) => Math.max(Math.abs(box[a] - fr.eye[a]), Math.abs(box[3 + a] - fr.eye[a]))));
      const grow = (reach * 2 * Math.hypot(fr.tanX, fr.tanY)) / n;
      const [wide, high] = rectangle(box.map((x, i) => x + (i < 3 ? -grow : grow)));
      expect(measured).toBeLessThanOrEqual(wide * high + 1e-9);
      if (!boxMeets(fr, box, 0)) expect(measured).toBe(0);
      expect(measured).toBeLessThanOrEqual(n * n * (1 + 1e-12));
    }
  });

  it("of a screen-filling polygon are the screen", () => {
    const fr = setFrustum(makeFrustum(), cameraFrame([1, 2, 3], [0, 0, -1]), 45, 16 / 9);
    const quad = [-9, -9, -2, 9, -9, -2, 9, 9, -2, -9, 9, -2];
    expect(polygonPixels(fr, quad, 0, 4, 1280, 720)).toBeCloseTo(1280 * 720, 6);
    const half = quad.map((x) => (x === -9 ? 0 : x));
    expect(polygonPixels(fr, half, 0, 4, 1280, 720)).toBeCloseTo((1280 * 720) / 4, 6);
    expect(polygonPixels(fr, quad.map((x) => -x), 0, 4, 1280, 720)).toBe(0);
  });
});

describe("intervals", () => {
  const edges = [-1, -0.4142135623730951, 0, 0.4142135623730951, 1];
  it("are half-open, and the last holds its upper end", () => {
    expect(findInterval(edges, [1, 0, 0])).toBe((0 * 4 + 2) * 4 + 2);
    expect(findInterval(edges, [2, 2, -2])).toBe((0 * 4 + 0) * 4 + 3); // ties go to the smallest axis
    expect(findInterval(edges, [0, -3, 0.1])).toBe((3 * 4 + 2) * 4 + 2);
    expect(findInterval(edges, [0, 0, 0])).toBe(-1);
    expect(findInterval(edges, [Number.NaN, 0, 1])).toBe(-1);
  });
  it("hold the direction that names them", () => {
    const next = random(5);
    for (let k = 0; k < 3000; k++) {
      const d = [next() - 0.5, next() - 0.5, next() - 0.5];
      const { face, i, j } = splitInterval(findInterval(edges, d), 4);
      const m = face >> 1;
      const length = Math.abs(d[m]);
      expect(d[m] < 0).toBe(face % 2 === 1);
      for (const [ratio, at] of [[d[(m + 1) % 3] / length, i], [d[(m + 2) % 3] / length, j]]) {
        expect(ratio).toBeGreaterThanOrEqual(edges[at]);
        expect(ratio).toBeLessThanOrEqual(edges[at + 1]);
      }
    }
  });
});

describe("cells", () => {
  // Two boxes that share a face at x = 4, cut there: [0,4] x [0,1] x [0,4] and [4,8] x [0,1] x [0,4].
  const tree = {
    nodeAxis: Int8Array.of(0, -1, -1), nodePlane: Float64Array.of(4, 0, 0), nodeLow: Int32Array.of(1, -1, -1),
    nodeHigh: Int32Array.of(2, -1, -1), nodeStart: Int32Array.of(0, 0, 1),
    viewBox: Float64Array.of(0, 0, 0, 4, 1, 4, 4, 0, 0, 8, 1, 4),
  };
  const shift = (o: Vec3) => ({
    origin_m: o,
    view_space: [0, 1].map((b) => [0, 3].map((k) => [0, 1, 2].map((a) => tree.viewBox[6 * b + k + a] + o[a]))) as Box[],
  });
  it("share no point, and their outer faces belong to the view space", () => {
    for (const o of [[0, 0, 0], [1000.1, -3, 7.3]] as Vec3[]) {
      const at = (x: number, y: number, z: number): number => findCell(tree, shift(o), [x + o[0], y + o[1], z + o[2]]);
      expect(at(3.999, 0.5, 1)).toBe(0);
      expect(at(4, 0.5, 1)).toBe(1);
      expect(at(8, 1, 4)).toBe(1);
      expect(at(0, 0, 0)).toBe(0);
      expect(at(8.001, 0.5, 1)).toBe(-1);
      expect(at(4, 1.001, 1)).toBe(-1);
    }
  });
  it("a point on the high face of the only box that holds it stays on that box's side of the plane", () => {
    const flat = { ...tree, viewBox: Float64Array.of(0, 0, 0, 4, 1, 4, 6, 0, 0, 8, 1, 4) };
    const manifest = { origin_m: [0, 0, 0] as Vec3, view_space: [[[0, 0, 0], [4, 1, 4]], [[6, 0, 0], [8, 1, 4]]] as Box[] };
    expect(findCell(flat, manifest, [4, 0.5, 1])).toBe(0);
  });
});

describe("the camera's place", () => {
  it("is clamped to the nearest point of the boxes, and stays where it is inside", () => {
    const next = random(6);
    const boxes: Box[] = [[[0, 0, 0], [4, 1, 4]], [[6, 0, 0], [8, 2, 4]]];
    for (let k = 0; k < 2000; k++) {
      const p: Vec3 = [next() * 14 - 3, next() * 4 - 1, next() * 8 - 2];
      const q: Vec3 = [0, 0, 0];
      clampToBoxes(boxes, p, q);
      expect(insideBoxes(boxes, q)).toBe(true);
      if (insideBoxes(boxes, p)) expect(q).toEqual(p);
      const other: Vec3 = [6 * next() < 3 ? 4 * next() : 6 + 2 * next(), next(), 4 * next()];
      if (insideBoxes(boxes, other)) {
        const gap = (a: Vec3): number => Math.hypot(a[0] - p[0], a[1] - p[1], a[2] - p[2]);
        expect(gap(q)).toBeLessThanOrEqual(gap(other) + 1e-12);
      }
    }
  });
});
