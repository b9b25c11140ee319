import { describe, expect, it } from "vitest";
import type { PlacementIndex } from "../placementdb/index_file";
import { findInterval } from "../select/intervals";
import { heldWires, impostorWires } from "./wires";

const index = {
  impostorCluster: Int32Array.of(0, 0),
  impostorKind: Uint8Array.of(0, 1),
  impostorViewCell: Float64Array.of(10, 20, 30, 0.6, 0, 0.8, 0.25, 40, Infinity, 1, 2, 3, 5, 6, 7, 0, 0, 0),
  clusterBox: Float64Array.of(-1, -1, -1, 1, 1, 1),
  cellNode: Int32Array.of(0),
  nodeBox: Float64Array.of(0, 0, 0, 4, 2, 8),
} as unknown as PlacementIndex;

function* points(ends: Float32Array): Generator<number[]> {
  for (let k = 0; k < ends.length; k += 3) yield [ends[k], ends[k + 1], ends[k + 2]];
}

describe("wire frames", () => {
  it("of a shaft lie on its cone, between near and a finite far", () => {
    const { ends, anchor } = impostorWires(index, 0, 100);
    expect(anchor).toEqual([10, 20, 30]);
    const cone = [...points(ends)].slice(24); // after the box
    for (const [x, y, z] of cone) {
      const along = 0.6 * x + 0.8 * z;
      const aside = Math.sqrt(Math.max(0, x * x + y * y + z * z - along * along));
      expect([40, 140].some((d) => Math.abs(along - d) < 1e-3)).toBe(true);
      expect(aside).toBeCloseTo(0.25 * along, 3);
    }
    expect(ends.every(Number.isFinite)).toBe(true);
  });

  it("of a box of cells are its edges and those of what it replaces", () => {
    const all = [...points(impostorWires(index, 1, 100).ends)];
    expect(all).toHaveLength(48);
    expect(Math.max(...all.slice(24).map((p) => p[0]))).toBe(4); // 5 - 1
    expect(Math.min(...all.slice(0, 24).map((p) => p[1]))).toBe(-3); // -1 - 2
  });

  it("of a held interval open where its directions end", () => {
    const edges = [-1, -0.4, 0, 0.4, 1];
    for (let interval = 0; interval < 96; interval++) {
      const { ends, anchor } = heldWires(index, 0, interval, edges, 30);
      expect(anchor).toEqual([2, 1, 4]);
      const corners = [...points(ends)].slice(24).filter((p) => Math.hypot(...p) > 1);
      const middle = [0, 1, 2].map((a) => corners.reduce((s, p) => s + p[a], 0));
      expect(findInterval(edges, middle)).toBe(interval);
      for (const p of corners) expect(Math.hypot(...p)).toBeCloseTo(30, 4);
    }
  });
});
