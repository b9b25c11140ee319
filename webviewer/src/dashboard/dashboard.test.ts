import { describe, expect, it } from "vitest";
import type { JobEvent, StageRow } from "../api/types";
import { bearing } from "../ui/format";
import { readView, viewAddress } from "../ui/view_link";
import { BREAKS, classOf } from "./cell_classes";
import { csv } from "../ui/csv";
import { estimate, Ratchet } from "./estimate";
import { ago, duration, metres, parseBudget, sentences, shortDigest, timeRange } from "./format";
import { addHistory, apply, emptyState, lineOf, setShards, squares, type Shard } from "./job_state";
import { DigitKeys } from "./digit_keys";
import { boxesPath, pictureFrame, planeOf } from "./scene_plan";

const NAMES = ["scene", "viewspace", "placement", "bake"] as const;

function stages(...rows: [StageRow["state"], number | null, number, number][]): StageRow[] {
  return rows.map(([state, seconds, done, total], k) => ({
    name: NAMES[k], state, seconds, skipped: null, peak_bytes: null, shards: { total, done, ready: total - done, running: 0, failed: 0, cancelled: 0 },
  }));
}

describe("time left", () => {
  const running = stages(["done", 10, 1, 1], ["running", 40, 4, 16], ["waiting", null, 0, 0], ["waiting", null, 0, 0]);

  it("is not known before a shard of the running stage has finished", () => {
    const none = stages(["done", 10, 1, 1], ["running", 40, 0, 16], ["waiting", null, 0, 0], ["waiting", null, 0, 0]);
    expect(estimate(none, [{ scene: 10, viewspace: 50, placement: 100, bake: 50 }]).left).toBeNull();
    expect(estimate(none, []).basis).toContain("first of 16");
  });

  it("covers the running stage alone without an earlier job, and says so", () => {
    const found = estimate(running, []);
    expect(found.left!.later).toBe(2);
    expect(found.left!.low).toBeLessThan(120); // 40 s for 4 of 16: 120 s for the rest
    expect(found.left!.high).toBeGreaterThan(120);
  });

  it("scales earlier jobs by this job's own pace, and spans them", () => {
    const histories = [{ scene: 5, viewspace: 80, placement: 60, bake: 30 }, { scene: 10, viewspace: 160, placement: 200, bake: 100 }];
    const found = estimate(running, histories);
    expect(found.left!.later).toBe(0);
    expect(found.left!.low).toBeLessThan(120 + 180); // twice as slow as the first job
    expect(found.left!.high).toBeGreaterThan(120 + 300);
    expect(found.basis).toBe("from 4 of 16 shards and 2 earlier jobs");
  });

  it("rests on earlier jobs for a stage of one shard", () => {
    const one = stages(["done", 10, 1, 1], ["done", 40, 16, 16], ["running", 5, 0, 1], ["waiting", null, 0, 0]);
    expect(estimate(one, []).left).toBeNull();
    const found = estimate(one, [{ scene: 10, viewspace: 40, placement: 65, bake: 20 }]);
    expect(found.left!.low).toBeLessThan(80);
    expect(found.left!.high).toBeGreaterThan(80);
  });

  it("ends at nothing left, and its ticks are the ends of stages", () => {
    const done = stages(["done", 1, 1, 1], ["skipped", 0, 0, 0], ["done", 1, 1, 1], ["done", 1, 1, 1]);
    expect(estimate(done, []).fraction).toBe(1);
    expect(estimate(running, []).ends).toEqual([0.25]);
    expect(estimate(running, []).fraction).toBeCloseTo(0.25 + 0.25 * 0.25);
  });

  it("never lets a bar run backwards", () => {
    const ratchet = new Ratchet();
    expect([0.2, 0.1, 0.3].map((f) => ratchet.at("a", f))).toEqual([0.2, 0.2, 0.3]);
    expect(ratchet.at("b", 0.05)).toBe(0.05);
  });
});

const shardEvent = (seq: number, ordinal: number, state: string, more = {}): JobEvent => ({
  seq, kind: "shard", at: "2026-01-31T09:15:00.000Z", data: { stage: "viewspace", kind: "run", ordinal, state, ...more },
});

describe("the state of a job", () => {
  it("is the same when events come twice, or overlap the snapshot", () => {
    const events: JobEvent[] = [
      { seq: 1, kind: "stage", at: "2026-01-31T09:15:00.000Z", data: { stage: "viewspace", state: "running", shards: 3 } },
      shardEvent(2, 0, "running", { attempt: 1 }), shardEvent(3, 0, "ready", { attempt: 1, error: { message: "lost" } }),
      shardEvent(4, 0, "running", { attempt: 2 }), shardEvent(5, 0, "done", { seconds: 2 }), shardEvent(6, 2, "running", { attempt: 1 }),
    ];
    const once = emptyState();
    for (const e of events) apply(once, e);
    const twice = emptyState();
    for (const e of [...events, ...events]) apply(twice, e);
    expect(twice).toEqual(once);
    const list = once.shards.get("viewspace")!.get("run")!;
    expect(list.map((s) => s.state)).toEqual(["done", "ready", "running"]);
    expect(list[0].attempt).toBe(2);
    const later = emptyState();
    setShards(later, "viewspace", list.map((s, ordinal) => ({ kind: "run", ordinal, state: s.state, attempt: s.attempt, cached: false, seconds: s.seconds, peak_bytes: null, worker: null, error: null })));
    for (const e of events.slice(4)) apply(later, e);
    expect(later.shards.get("viewspace")!.get("run")!.map((s) => s.state)).toEqual(["done", "ready", "running"]);
  });

  it("asks for the job anew when a stage moves, not for each shard", () => {
    const state = emptyState();
    expect(apply(state, shardEvent(1, 0, "running"))).toBe(false);
    expect(apply(state, { seq: 2, kind: "stage", at: "2026-01-31T09:15:00.000Z", data: { stage: "viewspace", state: "merging" } })).toBe(true);
  });

  it("drops what is open when the job is cancelled", () => {
    const state = emptyState();
    apply(state, shardEvent(1, 0, "running"));
    apply(state, shardEvent(2, 1, "done", { seconds: 1 }));
    apply(state, { seq: 3, kind: "job", at: "2026-01-31T09:15:00.000Z", data: { state: "cancelled" } });
    expect(state.shards.get("viewspace")!.get("run")!.map((s) => s.state)).toEqual(["cancelled", "done"]);
  });

  it("keeps each line of the log once, in order", () => {
    const state = emptyState();
    apply(state, shardEvent(5, 0, "done", { seconds: 1 }));
    addHistory(state, [shardEvent(3, 0, "ready", { error: { message: "no memory" } }), shardEvent(4, 0, "running", { attempt: 2 })]);
    apply(state, shardEvent(4, 0, "running", { attempt: 2 }));
    expect(state.log.map((l) => l.seq)).toEqual([3, 4, 5]);
    expect(state.log.map((l) => l.level)).toEqual(["warn", "warn", "info"]);
    expect(lineOf(shardEvent(9, 4, "failed", { error: { message: "it broke", advice: "Mend it" } })).text).toBe("failed: it broke. Mend it.");
  });

  it("shows the worst of a block where there are more shards than squares", () => {
    const list: Shard[] = Array.from({ length: 5000 }, () => ({ state: "done", attempt: 1, cached: false, seconds: 1, peakBytes: null, worker: null, sinceMs: null, error: null }));
    list[4001] = { ...list[4001], state: "failed" };
    list[7] = { ...list[7], attempt: 3 };
    const found = squares(list);
    expect(found.length).toBeLessThanOrEqual(2000);
    expect(found.reduce((n, s) => n + s.count, 0)).toBe(5000);
    expect(found.filter((s) => s.state === "failed").map((s) => s.first)).toEqual([3999]);
    expect(found.filter((s) => s.retried).length).toBe(1);
  });
});

describe("words and numbers", () => {
  it("are short and never claim more than is known", () => {
    expect([0.04, 9.94, 9.96, 59.4, 62, 3599.6, 4320].map(duration)).toEqual(["0.0 s", "9.9 s", "10 s", "59 s", "1 min 02 s", "1 h 00 min", "1 h 12 min"]);
    expect(timeRange(480, 780)).toBe("8 to 13 min");
    expect(timeRange(12, 31)).toBe("10 to 35 s");
    expect(timeRange(3, 8)).toBe("up to 10 s");
    expect(timeRange(5000, 9000)).toBe("1 to 2.5 h");
    expect(ago(0, 59_000)).toBe("just now");
    expect(ago(0, 14 * 60_000)).toBe("14 min ago");
    expect([1500, 84.6, 0.25, 16, 100].map(metres)).toEqual(["1500", "84.6", "0.25", "16", "100"]);
    expect(shortDigest("4b1e".padEnd(60, "0") + "9c07")).toBe("4b1e…9c07");
    expect(sentences("It broke", "", undefined, "Mend it.")).toBe("It broke. Mend it.");
    expect([[0, 0, -1], [1, 0, 0], [0, 0, 1], [-1, 0, 0]].map(bearing)).toEqual([0, 90, 180, 270]);
  });

  it("read budgets as the service does", () => {
    expect(parseBudget("16 ms")).toEqual({ amount: 16, unit: "ms" });
    expect(parseBudget("200_000 triangles")).toEqual({ amount: 200000, unit: "triangles" });
    expect(parseBudget("1 call")).toEqual({ amount: 1, unit: "calls" });
    for (const text of ["fast", "-3 ms", "16", "16 m s"]) expect(parseBudget(text)).toBeNull();
  });

  it("make tables that no spreadsheet runs", () => {
    const text = csv(["a", "b"], [["=HYPERLINK(1)", -1.5], ['say "hi", twice', null], ["two\nlines", 0]]);
    expect(text).toBe('a,b\r\n\'=HYPERLINK(1),-1.5\r\n"say ""hi"", twice",\r\n"two\nlines",0\r\n');
  });

  it("class a cell as over budget exactly where it is", () => {
    expect(classOf(1300, 1300)).toBe(4);
    expect(classOf(1301, 1300)).toBe(5);
    expect(classOf(0, 1300)).toBe(0);
    expect(classOf(1e9, 1300)).toBe(8);
    for (let cost = 0; cost < 4000; cost += 7) expect(classOf(cost, 1300) > 4).toBe(cost > 1300);
    expect(BREAKS.length).toBe(8);
  });
});

describe("places", () => {
  it("travel in an address without losing a digit", () => {
    const position = [0.1 + 0.2, -320.123456789, 1e-9];
    const direction = [0, 0, -1];
    const address = viewAddress("a b", position, direction);
    expect(address.startsWith("/viewer/a%20b#at=")).toBe(true);
    expect(readView(address.slice(address.indexOf("#")))).toEqual({ position, direction });
    for (const bad of ["", "#at=1,2&to=0,0,1", "#at=1,2,x&to=0,0,1", "#at=1,2,3&to=0,0,0", "#at=,,&to=0,0,1"]) expect(readView(bad)).toBeNull();
  });

  it("lie in a plan of the picture's aspect, that holds them all", () => {
    const plane = planeOf([[[0, 0, 0], [10, 1, 100]]], 1.5);
    const [wide, deep] = [plane.high[0] - plane.low[0], plane.high[1] - plane.low[1]];
    expect(wide / deep).toBeCloseTo(1.5);
    expect(plane.low[1]).toBeLessThan(0);
    expect(plane.high[1]).toBeGreaterThan(100);
    expect(boxesPath([[[0, 0, 0], [10, 1, 100]]], plane)).toBe("M0 0H10V100H0z");
  });
});

describe("number keys", () => {
  it("reach every stage: the first digit counts at once, a second one soon after makes a number of two", () => {
    const keys = new DigitKeys();
    expect([keys.press(1, 0, 14), keys.press(4, 500, 14)]).toEqual([1, 14]);
    expect([keys.press(4, 600, 14), keys.press(1, 700, 14), keys.press(2, 800, 14)]).toEqual([4, 1, 12]); // 41 is none
    expect([keys.press(1, 2000, 14), keys.press(3, 4000, 14)]).toEqual([1, 3]); // too late
    expect([keys.press(0, 9000, 14), keys.press(1, 9100, 9), keys.press(2, 9200, 9)]).toEqual([0, 1, 2]);
  });
});

describe("picture from above", () => {
  it("lies on the plan pixel by pixel, its shorter side rounded up to whole pixels", () => {
    const frame = pictureFrame([[10, 0, -5], [10 + 512, 3, -5 + 100.5]]);
    expect(frame).toEqual({ x: 10, y: -5, width: 512, height: 101 });
    expect(pictureFrame([[0, 0, 0], [588, 18, 460]]).height).toBeCloseTo((401 * 588) / 512);
  });
});
