import { describe, expect, it } from "vitest";
import type { Worker } from "../api/types";
import { pauseMs } from "./pause";
import { rowWindow } from "./row_window";
import { busyShare, renderer, spread, unserved } from "./worker_facts";

function worker(change: Partial<Worker>): Worker {
  return {
    name: "a:1", host: "a", queues: ["cpu"], capability: { cores: 2, memory_bytes: 1, version: "1", renderer: null }, state: "idle", started_at: "2026-01-01T00:00:00Z",
    heartbeat_at: "2026-01-01T00:01:40Z", silent_s: 1, shard: null, stage: null, shard_s: null, done: 0, failed: 0, busy_seconds: 25, shards_per_minute: 3, ...change,
  };
}

describe("workers", () => {
  it("says the share of its life that one computed, never more than all of it", () => {
    expect(busyShare(worker({}))).toBeCloseTo(0.25);
    expect(busyShare(worker({ busy_seconds: 1000 }))).toBe(1);
    expect(busyShare(worker({ heartbeat_at: "2026-01-01T00:00:00.200Z" }))).toBeNull();
  });

  it("counts the pace of those that live alone", () => {
    expect(spread([worker({ state: "busy" }), worker({}), worker({ state: "silent", shards_per_minute: 50 })])).toBe("1 busy, 1 idle, 1 silent, 6.0 shards a minute");
  });

  it("names queues that nobody takes from", () => {
    expect(unserved({ workers: [], queues: { cpu: 2, optimizer: 0, gl: 0 } })).toEqual(["optimizer", "gl"]);
  });

  it("tells a renderer that is not known yet from one that is not needed", () => {
    expect(renderer(worker({}))).toBe("does not bake");
    expect(renderer(worker({ queues: ["gl"] }))).toBe("renderer not asked yet");
  });
});

describe("asking gently", () => {
  it("asks rarer the longer nobody answers, and at least once a minute", () => {
    expect([0, 1, 2, 3, 9].map((n) => pauseMs(5000, n))).toEqual([5000, 10_000, 20_000, 40_000, 60_000]);
  });
});

describe("rows of a long list", () => {
  it("are those in sight and some around them, at both ends too", () => {
    expect(rowWindow(10_000, 58, -200, 900, -1)).toEqual({ first: 0, last: 25 });
    const middle = rowWindow(10_000, 58, 58 * 5000, 900, -1);
    expect(middle.first).toBe(4988);
    expect(middle.last).toBe(5000 + 16 + 12);
    expect(rowWindow(10_000, 58, 58 * 9990, 900, -1)).toEqual({ first: 9978, last: 10_000 });
    expect(rowWindow(10_000, 58, 1e9, 900, -1)).toEqual({ first: 9988, last: 10_000 });
    expect(rowWindow(0, 58, -10, 900, -1)).toEqual({ first: 0, last: 0 });
  });

  it("keep the row with the focus while it is near, and never grow without bound", () => {
    expect(rowWindow(10_000, 58, 58 * 5000, 900, 4970).first).toBe(4969);
    const far = rowWindow(10_000, 58, 58 * 5000, 900, 3);
    expect(far.last - far.first).toBeLessThan(120);
  });
});
