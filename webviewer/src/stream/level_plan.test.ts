import { describe, expect, it } from "vitest";
import type { GeometryIndex } from "../placementdb/geometry";
import type { GeometryEntry } from "../placementdb/manifest";
import { LevelPlan, PREFETCH_SHARE } from "./level_plan";

/** Objects 0 to 5 along x; objects 0 and 5 share mesh 0, whose coarse level is model 1; mesh 1 has texture file 0. */
const index = {
  objectMesh: Int32Array.of(0, 1, 2, 3, 4, 0),
  meshPrimitive: Int32Array.of(0, 1, 2, 3, 4, 5),
  primitiveMaterial: Int32Array.of(0, 1, 0, 0, 0),
  meshModel: Int32Array.of(0, 2, 3, 4, 5, 6),
  modelPage: Int32Array.of(0, 4, 1, 2, 2, 3),
  texture: Int32Array.of(-1, 0),
  glow: Int32Array.of(-1, -1),
  textureFile: Int32Array.of(0),
} as unknown as GeometryIndex;
const entry = { pages: new Array(5), textures: new Array(1) } as unknown as GeometryEntry;
const boxes = Float64Array.from([0, 1, 2, 3, 4, 5].flatMap((x) => [10 * x, 0, 0, 10 * x + 1, 1, 1]));
const bytes = new Float64Array(6).fill(10);
const plan = new LevelPlan(index, entry, boxes);
const none = new Uint8Array(6);
const wanted = (view: number[], covered: number[], visible: number[] | null, levels: Uint8Array, x: number, cap: number): ReturnType<LevelPlan["wanted"]> =>
  plan.wanted(Int32Array.from(view), view.length, none.map((_, o) => (covered.includes(o) ? 1 : 0)), visible && Int32Array.from(visible), levels, [x, 0, 0], bytes, cap);

describe("the plan of the level", () => {
  it("takes what is in view, nearest first, with its textures; then what the cell sees; then the rest", () => {
    const found = wanted([3, 1], [], [1, 2, 3, 4], none, 0, 1e9);
    expect(found).toEqual({ parts: [1, 5, 2, 3, 0], urgent: 3, near: 4 });
  });
  it("does not hurry for what impostors will show", () => {
    expect(wanted([3, 1], [1], [1, 2, 3, 4], none, 0, 1e9)).toEqual({ parts: [2, 1, 5, 3, 0], urgent: 1, near: 4 });
  });
  it("fetches the level of detail that is drawn, and no other", () => {
    const coarse = Uint8Array.of(1, 0, 0, 0, 0, 1);
    expect(wanted([0], [], null, coarse, 0, 1e9).parts).toEqual([4, 1, 5, 2, 3]);
    const mixed = Uint8Array.of(0, 0, 0, 0, 0, 1);
    expect(wanted([0], [], null, mixed, 0, 1e9).parts.sort()).toEqual([0, 1, 2, 3, 4, 5]);
  });
  it("keeps to the memory: all of it for what is in view, the rest only up to a share", () => {
    expect(wanted([1, 2, 4], [], null, none, 0, 40).parts).toEqual([1, 5, 2, 3]);
    expect(wanted([4], [], null, none, 0, 50).parts.length).toBe(Math.floor(PREFETCH_SHARE * 5));
    expect(wanted([4], [], null, none, 0, 1).parts).toEqual([3]); // one part whatever its size
  });
});
