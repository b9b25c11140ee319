import { describe, expect, it } from "vitest";
import { alone, COLUMNS, frameAt, FRAMES, meshesFor, MOST, predictedMs, rectangle, SIDES, type Load } from "./plan";

const most: Load = { calls: 900, triangles: 400_000, pixels: 6_000_000, impostors: 300, impostor_triangles: 4000, impostor_pixels: 5_000_000 };
const frames = Array.from({ length: FRAMES }, (_, k) => frameAt(k, most));

describe("frames to measure", () => {
  it("vary every column by more than the fit asks for, from the 5th to the 95th percentile", () => {
    for (const column of COLUMNS) {
      const sorted = frames.map((f) => f[column]).sort((a, b) => a - b);
      const [low, high] = [sorted[Math.floor(0.05 * FRAMES)], sorted[Math.floor(0.95 * FRAMES)]];
      expect(high).toBeGreaterThan(4 * low);
      expect(sorted.at(-1)!).toBeLessThanOrEqual(most[column]);
    }
  });

  it("let no column rise and fall with another", () => {
    for (const a of COLUMNS) {
      for (const b of COLUMNS) {
        if (a >= b || a.startsWith("impostor") !== b.startsWith("impostor")) continue;
        const [x, y] = [frames.map((f) => f[a]), frames.map((f) => f[b])];
        const mean = (v: number[]): number => v.reduce((s, n) => s + n, 0) / v.length;
        const [mx, my] = [mean(x), mean(y)];
        const covariance = mean(x.map((v, k) => (v - mx) * (y[k] - my)));
        const r = covariance / Math.sqrt(mean(x.map((v) => (v - mx) ** 2)) * mean(y.map((v) => (v - my) ** 2)));
        expect(Math.abs(r)).toBeLessThan(0.7);
      }
    }
  });

  it("have some without impostors, and some without objects", () => {
    expect(frames.filter((f) => f.impostors === 0).length).toBeGreaterThan(10);
    expect(frames.filter((f) => f.calls === 0).length).toBeGreaterThan(10);
  });

  it("are possible: what is alone in a frame can be drawn with what comes along", () => {
    for (const column of COLUMNS) {
      const load = alone(column, MOST[column]);
      expect(load[column]).toBe(MOST[column]);
      const objects = !column.startsWith("impostor");
      expect(objects ? load.impostors : load.calls).toBe(0);
      if (objects) expect(meshesFor(load.calls, load.triangles).reduce((sum, n, k) => sum + 2 * n * SIDES[k] ** 2, 0)).toBeGreaterThanOrEqual(0.9 * load.triangles);
    }
  });
});

describe("meshes", () => {
  it("are as many as the calls, and have about the triangles", () => {
    for (const load of frames) {
      const found = meshesFor(load.calls, load.triangles);
      expect(found.reduce((a, b) => a + b, 0)).toBe(load.calls);
      expect(found.every((n) => n >= 0 && Number.isInteger(n))).toBe(true);
      const triangles = found.reduce((sum, n, k) => sum + 2 * n * SIDES[k] ** 2, 0);
      if (load.calls > 5) expect(Math.abs(triangles - load.triangles)).toBeLessThan(0.25 * load.triangles + 600);
    }
  });

  it("cover the area that they are to, within the picture", () => {
    expect(rectangle(10_000, 1280, 720)).toEqual([100, 100]);
    expect(rectangle(900_000, 1280, 720)).toEqual([1250, 720]);
    expect(rectangle(9e9, 1280, 720)).toEqual([1280, 720]);
  });
});

it("predicts as the cost model adds up", () => {
  const of = { per_frame_ns: 1e6, per_call_ns: 1000, per_triangle_ns: 2, per_pixel_ns: 0.5, per_impostor_ns: 100, per_impostor_triangle_ns: 3, per_impostor_pixel_ns: 0.25 };
  expect(predictedMs({ calls: 1000, triangles: 5e5, pixels: 2e6, impostors: 100, impostor_triangles: 1e4, impostor_pixels: 4e6 }, of)).toBeCloseTo(1 + 1 + 1 + 1 + 0.01 + 0.03 + 1, 9);
});
