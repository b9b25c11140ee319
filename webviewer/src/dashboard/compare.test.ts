import { describe, expect, it } from "vitest";
import type { Settings } from "../api/schema";
import { change, differences, figuresOf } from "./compare_facts";
import { addView, className, emptyHistogram } from "./histogram";
import type { Report } from "./report_types";

const figure = (a: number | null, b: number | null): Parameters<typeof change>[0] => ({ name: "", a, b, text: String, less: true });

describe("comparing jobs", () => {
  it("names settings that differ, also those that only one of them states", () => {
    const a = { budget: "16 ms", camera: { fov_deg: 45, width: 1280 }, view_space: { cell_m: null } } as Settings;
    const b = { budget: "18 ms", camera: { fov_deg: 45, width: 1920 }, view_space: { cell_m: null }, seed: 3 } as Settings;
    expect(differences(a, b)).toEqual([
      { key: "budget", a: "16 ms", b: "18 ms" }, { key: "camera.width", a: "1280", b: "1920" }, { key: "seed", a: "—", b: "3" },
    ]);
    expect(differences(a, structuredClone(a))).toEqual([]);
  });

  it("sets no costs of different units side by side, and leaves out what neither has", () => {
    const report = (change: Partial<Report>): Report => ({ verdict: "valid", stages: [], ...change });
    const names = (a: Report, b: Report): string[] => figuresOf(a, b).map((f) => f.name);
    expect(names(report({ worst_cost_bound: 5, unit: "ns" }), report({ worst_cost_bound: 5, unit: "calls" }))).toEqual([]);
    expect(names(report({ worst_cost_bound: 5, unit: "ns" }), report({ unit: "ns", bytes: 4 }))).toEqual(["Impostor memory", "Worst view, bound as placed"]);
  });

  it("says by how much the second differs", () => {
    expect([figure(200, 150), figure(100, 104.2), figure(0, 3), figure(5, 5), figure(null, 5)].map(change)).toEqual(["−25 %", "+4.2 %", "new", "", ""]);
  });
});

describe("views by cost", () => {
  it("are counted so that a view of just the budget lies within it", () => {
    const of = emptyHistogram();
    addView(of, 101, 100, 100);
    addView(of, 300, 20, 100);
    expect(of.asGeometry).toEqual([0, 0, 0, 0, 0, 1, 0, 0, 1]);
    expect(of.asPlaced).toEqual([1, 0, 0, 0, 1, 0, 0, 0, 0]);
    expect([0, 4, 5, 8].map(className)).toEqual(["up to 0.35", "0.9 to 1", "1 to 1.25", "over 2.2"]);
  });
});
