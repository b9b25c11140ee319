/** What is drawn is what the placement counted on: the visible set of the camera's cell, no more and no less. */
import { existsSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { describe, expect, it } from "vitest";
import { chunkOfCell, impostorsOfView, Placement, viewInChunk, visibleOfCell } from "../placementdb/placement";
import type { Vec3 } from "../placementdb/manifest";
import { boxMeets, cameraFrame, makeFrustum, setFrustum } from "./frustum";
import { Selector } from "./select";

const TREE = resolve(import.meta.dirname, "../../../tests/golden/placementdb-visible");
const golden = JSON.parse(readFileSync(join(TREE, "lookups.json"), "utf8"));

async function open(): Promise<Placement> {
  return Placement.open(async (name) => (existsSync(join(TREE, name)) ? new Uint8Array(readFileSync(join(TREE, name))) : null));
}

describe("a cell's visible set", () => {
  it("is drawn exactly, and each impostor of the view is counted once", async () => {
    const placement = await open();
    const { index, manifest } = placement;
    const selector = new Selector(index, manifest);
    let withImpostors = 0, hidden = 0;
    for (const g of golden.lookups) {
      const answer = await placement.lookup(g.position, g.direction);
      const k = chunkOfCell(manifest, answer.cell);
      const chunk = k < 0 ? null : await placement.chunk(k);
      const view = chunk ? viewInChunk(chunk, answer.cell, answer.interval) : -1;
      const visible = visibleOfCell(chunk, answer.cell);
      expect(visible).not.toBeNull();
      selector.setView(answer.cell, visible, chunk, view < 0 ? [] : Array.from(impostorsOfView(chunk!, view)));
      const eye = (g.position as Vec3).map((x, a) => x - manifest.origin_m[a]) as Vec3;
      const camera = manifest.camera;
      const frustum = setFrustum(makeFrustum(), cameraFrame(eye, g.direction), camera.fov_deg, camera.width / camera.height);
      const s = selector.select(frustum);
      const drawn = Array.from(s.objects.subarray(0, s.nObjects)).sort((a, b) => a - b);
      expect(drawn).toEqual(answer.objects.filter((o: number) => boxMeets(frustum, index.objectBox, 6 * o)));
      // In calls an impostor of the view costs one, seen or not, and a hidden object nothing.
      const fixed = drawn.reduce((sum, o) => sum + index.objectCost[o], manifest.cost_model.per_frame + answer.impostors.length * manifest.cost_model.per_impostor);
      expect(s.cost).toBe(fixed);
      withImpostors += Number(answer.impostors.length > 0);
      hidden += Number(visible!.length < manifest.counts.objects);
    }
    expect(withImpostors).toBeGreaterThan(10);
    expect(hidden).toBeGreaterThan(10);
  });

  it("leaves objects of an impostor whose page is missing as geometry, the hidden ones among them hidden", async () => {
    const placement = await open();
    const { index, manifest } = placement;
    const selector = new Selector(index, manifest);
    const everywhere = setFrustum(makeFrustum(), cameraFrame([0, 0, 1e4], [0, 0, -1]), 90, 1);
    for (const g of golden.lookups.slice(0, 20)) {
      const k = chunkOfCell(manifest, g.cell);
      const chunk = await placement.chunk(k);
      const visible = visibleOfCell(chunk, g.cell)!;
      selector.setView(g.cell, visible, chunk, []);
      const s = selector.select(everywhere);
      const seen = new Set(visible);
      expect(Array.from(s.objects.subarray(0, s.nObjects)).every((o) => seen.has(o))).toBe(true);
      expect(s.nObjects).toBe(Array.from(visible).filter((o) => boxMeets(everywhere, index.objectBox, 6 * o)).length);
    }
  });
});
