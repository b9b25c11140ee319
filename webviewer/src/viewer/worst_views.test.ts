import { describe, expect, it } from "vitest";
import { readWorstViews } from "./worst_views";

const view = (cost: number): Record<string, unknown> => ({ position: [1, 2, 3], direction: [0, 0, -1], cell: 4, cost_bound: cost, hopeless: cost > 5 });

describe("worst views of a report", () => {
  it("are the costliest nine, the costliest first", () => {
    const read = readWorstViews({ worst_views: Array.from({ length: 12 }, (_, k) => view(k)) });
    expect(read.map((v) => v.cost)).toEqual([11, 10, 9, 8, 7, 6, 5, 4, 3]);
    expect(read.map((v) => v.hopeless)).toEqual([true, true, true, true, true, true, false, false, false]);
  });

  it("leave out what cannot be looked from", () => {
    const wrong = [null, {}, { ...view(1), position: [1, 2] }, { ...view(1), direction: [0, 0, 0] }, { ...view(1), cost_bound: "1" }, { ...view(1), position: [1, 2, null] }];
    expect(readWorstViews({ worst_views: [...wrong, view(2)] })).toHaveLength(1);
    for (const report of [null, {}, [], { worst_views: 3 }, "no report"]) expect(readWorstViews(report)).toEqual([]);
  });
});
