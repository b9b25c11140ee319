import { describe, expect, it } from "vitest";
import type { EventData, JobEvent, LiveMap } from "../api/types";
import { emptyLive, takeLive, ticks } from "./live";
import { unsolvedBreaks } from "./view_map";

const MAP: LiveMap = { boxes: [0, 0, 1, 1, 1, 0, 2, 1, 2, 0, 3, 1], cost: [5, 9, 20], views: [0, 3, 8], budget: 10, unit: "calls" };
let seq = 0;

function told(data: EventData, kind: JobEvent["kind"] = "progress"): JobEvent {
  return { seq: ++seq, kind, at: new Date(1e12 + 1000 * seq).toISOString(), data: { stage: "placement", kind: "run", ordinal: 0, ...data } };
}

describe("what the optimiser tells", () => {
  it("is a curve, and counts by tile that only changes move", () => {
    const live = emptyLive();
    expect(takeLive(live, told({ state: "running" }, "shard"))).toBe(false);
    takeLive(live, told({ map: MAP }));
    takeLive(live, told({ first: true, bytes: 0, hopeless: 2, smallest_budget: 12, tiles: [[1, 3], [2, 8]] }));
    takeLive(live, told({ bytes: 500, tiles: [[1, 0]] }));
    takeLive(live, told({ bytes: 400 }));
    expect(live.tiles).toEqual([0, 0, 8]);
    expect(live.points.map((p) => [p.bytes, p.unsolved])).toEqual([[0, 11], [500, 8], [400, 8]]);
    expect([live.hopeless, live.smallestBudget]).toEqual([2, 12]);
  });

  it("begins anew with an attempt, whose first word is complete", () => {
    const live = emptyLive();
    takeLive(live, told({ map: MAP }));
    takeLive(live, told({ first: true, bytes: 100, tiles: [[1, 3], [2, 8]] }));
    takeLive(live, told({ first: true, attempt: 2, bytes: 80, tiles: [[2, 5]] }));
    expect(live.tiles).toEqual([0, 0, 5]);
    expect(live.points.at(-1)).toMatchObject({ bytes: 80, unsolved: 5 });
  });

  it("adds regions up, and forgets them once they are merged", () => {
    const live = emptyLive();
    takeLive(live, told({ map: { ...MAP, views: [0, 3, 0] } }));
    takeLive(live, told({ map: { ...MAP, views: [0, 0, 8] }, ordinal: 1 }));
    expect(live.map!.views).toEqual([0, 3, 8]);
    takeLive(live, told({ first: true, bytes: 10, tiles: [[1, 3]] }));
    takeLive(live, told({ ordinal: 1, first: true, bytes: 20, tiles: [[2, 8]] }));
    expect(live.points.at(-1)).toMatchObject({ bytes: 30, unsolved: 11 });
    takeLive(live, told({ kind: "merge", first: true, bytes: 25, tiles: [[2, 1]] }));
    expect(live.points.at(-1)).toMatchObject({ bytes: 25, unsolved: 1 });
    expect(live.tiles).toEqual([0, 0, 1]);
  });
});

describe("axes and classes", () => {
  it("have round steps that cover the most", () => {
    expect(ticks(71)).toEqual([0, 50, 100]);
    expect(ticks(9077)).toEqual([0, 5000, 10000]);
    expect(ticks(0)).toEqual([0, 1]);
    for (const most of [1e-3, 0.9, 1, 7, 42, 1234.5, 9.9e8]) {
      const found = ticks(most);
      expect(found.at(-1)!).toBeGreaterThanOrEqual(most * (1 - 1e-9));
      expect(found.length).toBeLessThanOrEqual(5);
    }
  });

  it("grow with the fullest cell", () => {
    expect(unsolvedBreaks(14)).toEqual([1, 2, 3, 5, 7, 10]);
    expect(unsolvedBreaks(1500)).toEqual([50, 100, 150, 250, 350, 500]);
  });
});
