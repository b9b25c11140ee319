import { readFileSync, existsSync } from "node:fs";
import { join, resolve } from "node:path";
import { describe, expect, it } from "vitest";
import { layOut, ROWS_WIDTH } from "../gl/chunk_buffers";
import { Placement } from "../placementdb/placement";
import { findInterval, intervalDirection } from "../select/intervals";
import { Walker } from "../viewer/camera";
import { ChunkPages, plan } from "./plan";
import type { Box, Manifest, Vec3 } from "../placementdb/manifest";

const GOLDEN = resolve(import.meta.dirname, "../../../tests/golden/placementdb");
const open = (): Promise<Placement> =>
  Placement.open(async (name) => (existsSync(join(GOLDEN, name)) ? new Uint8Array(readFileSync(join(GOLDEN, name))) : null));

describe("the streaming plan", () => {
  const chunk = (x: number, pages: number[], bytes = 10): unknown => ({ box: [[x, 0, 0], [x + 1, 1, 1]], pages, bytes });
  const manifest = { pages: new Array(6), chunks: [chunk(0, [0, 1]), chunk(2, [2, 1]), chunk(50, [3]), chunk(4, [4, 5])] } as unknown as Manifest;

  it("takes what is shown first, then this chunk, then chunks by where the camera is going", () => {
    expect(plan(manifest, 0, [1], [5, 0, 0], 99, 1e9)).toEqual({ chunks: [0, 3, 1, 2], pages: [1, 0, 4, 5, 2, 3] });
  });
  it("never wants more pages than there are slots, nor chunks past the cap, but always the current chunk", () => {
    expect(plan(manifest, 2, [3], [0, 0, 0], 2, 15)).toEqual({ chunks: [2], pages: [3] });
    expect(plan(manifest, 2, [3, 3], [0, 0, 0], 3, 20)).toEqual({ chunks: [2, 0], pages: [3, 0] });
    expect(plan(manifest, -1, [], [0, 0, 0], 3, 5).chunks).toEqual([0]);
  });
  it("puts the pages of directions near the present one first", async () => {
    const placement = await open();
    const loaded = await placement.chunk(0);
    const pages = new ChunkPages(loaded);
    for (let m = 0; m < loaded.impostorId.length; m++) {
      const all = loaded.layerPage.subarray(loaded.impostorLayer[m], loaded.impostorLayer[m + 1]);
      expect(new Set(pages.of(m))).toEqual(new Set(all));
      expect(pages.of(m).length).toBe(new Set(all).size);
    }
    const out = new Set<number>();
    pages.addCell(loaded.cells[0], [0, 0, -1], placement.manifest.interval_edges, out);
    const expected = new Set<number>();
    for (let v = loaded.cellView[0]; v < loaded.cellView[1]; v++) pages.addView(v, expected);
    expect(out).toEqual(expected);
  });
});

describe("intervals", () => {
  it("hold the direction in their middle", async () => {
    const { interval_edges } = (await open()).manifest;
    const n = interval_edges.length - 1;
    for (let k = 0; k < 6 * n * n; k++) expect(findInterval(interval_edges, intervalDirection(interval_edges, k))).toBe(k);
  });
});

describe("a chunk laid out for the GPU", () => {
  it("keeps every corner, and fans every polygon", async () => {
    const placement = await open();
    for (let k = 0; k < placement.manifest.chunks.length; k++) {
      const chunk = await placement.chunk(k);
      const anchor: Vec3 = [1, 2, 3];
      const out = layOut(chunk, anchor);
      const f32 = new Float32Array(out.vertices);
      const u32 = new Uint32Array(out.vertices);
      expect(out.triangles.length / 3).toBe(out.triangleRow.at(-1));
      for (let m = 0; m < chunk.impostorId.length; m++) {
        expect(out.triangleRow[m + 1] - out.triangleRow[m]).toBe(placement.index.impostorTriangles[chunk.impostorId[m]]);
        for (let r = chunk.impostorLayer[m]; r < chunk.impostorLayer[m + 1]; r++) {
          expect(out.rows[16 * r + 1]).toBeCloseTo(chunk.impostorEye[3 * m + 1] - 2, 4);
          expect(out.rows[16 * r + 6]).toBe(chunk.layerPage[r]);
          expect(out.rows[16 * r + 12]).toBe(chunk.impostorId[m] + 1);
        }
        for (let t = out.triangleRow[m]; t < out.triangleRow[m + 1]; t++) {
          for (const v of out.triangles.subarray(3 * t, 3 * t + 3)) {
            expect(u32[6 * v + 5]).toBeGreaterThanOrEqual(chunk.impostorLayer[m]);
            expect(u32[6 * v + 5]).toBeLessThan(chunk.impostorLayer[m + 1]);
            expect(f32[6 * v + 3]).toBe(chunk.cornerUv[2 * v]);
          }
        }
      }
      expect(out.rows.length).toBe(out.height * ROWS_WIDTH * 16);
    }
  });
});

describe("the walker", () => {
  const boxes: Box[] = [[[0, 1, 0], [10, 3, 10]], [[10, 4, 0], [20, 6, 10]]];
  it("never leaves the view space on foot, follows its floor, and may leave it in free flight", () => {
    const walker = new Walker(boxes);
    expect(walker.inside).toBe(true);
    walker.look([9, 2.5, 5], [1, 0, 0]);
    for (let k = 0; k < 100; k++) {
      walker.move(0, 0, 5, 0.1);
      expect(walker.inside).toBe(true);
    }
    expect(walker.position[0]).toBe(20);
    expect(walker.position[1]).toBeCloseTo(5.5);
    walker.setFree(true);
    walker.move(0, 0, 5, 1);
    expect(walker.inside).toBe(false);
    walker.setFree(false);
    expect(walker.inside).toBe(true);
  });
  it("keeps a direction that was set to the last bit until it turns", () => {
    const walker = new Walker(boxes);
    const d = [0.1, 0.7, -3.3];
    walker.look([1, 2, 3], d);
    expect(walker.direction).toEqual(d);
    const length = Math.hypot(...d);
    walker.turn(1e-9, 0);
    walker.direction.forEach((x, a) => expect(x).toBeCloseTo(d[a] / length, 6));
  });
});
