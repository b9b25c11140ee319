import { describe, expect, it } from "vitest";
import { BROKEN, HOPELESS, STREAMING, UNPROMISED, WITHIN, WalkLog, reasonOf, walkCsv, walkPlot, type FrameFacts } from "./log";
import { LINK_CHARACTERS, LONGEST_MS, Recorder, STEP_MS, Walk, WalkDamaged, WalkTooNew, crc32, decodeWalk, encodeWalk } from "./walk";
import type { Vec3 } from "../placementdb/manifest";

/** mulberry32 */
function random(seed: number): () => number {
  let s = seed;
  return () => {
    s = (s + 0x6d2b79f5) | 0;
    let t = Math.imul(s ^ (s >>> 15), 1 | s);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function recorded(seed: number, samples: number): { walk: Walk; path: number[][] } {
  const next = random(seed);
  const recorder = new Recorder();
  const path: number[][] = [];
  let [x, y, z, yaw, pitch, ms, turn] = [next() * 200 - 100, 1.7, next() * 200 - 100, 3, 0, next() * 5000, 0];
  recorder.start();
  for (let k = 0; k < samples; k++) {
    recorder.add(ms, [x, y, z], Math.atan2(Math.sin(yaw), Math.cos(yaw)), pitch);
    path.push([ms, x, y, z, yaw, pitch]);
    ms += 26 + next() * 20;
    if (next() < 0.02) turn = (next() - 0.5) * 0.1;
    yaw += turn;
    pitch = Math.max(-1.5, Math.min(1.5, pitch + (next() - 0.5) * 0.001));
    x -= Math.sin(yaw) * 0.15;
    z -= Math.cos(yaw) * 0.15;
  }
  return { walk: recorder.finish()!, path };
}

function sealed(body: number[]): string {
  const sum = crc32(body);
  const bytes = [...body, ...[0, 8, 16, 24].map((k) => (sum >>> k) & 255)];
  return Buffer.from(bytes).toString("base64url");
}

describe("a walk", () => {
  it("passes where it was recorded, through half turns too", () => {
    for (let seed = 0; seed < 5; seed++) {
      const { walk, path } = recorded(seed, 300);
      const position: Vec3 = [0, 0, 0];
      const direction: Vec3 = [0, 0, 0];
      for (const [ms, x, y, z, yaw, pitch] of path) {
        walk.at(ms - path[0][0], position, direction);
        expect(Math.hypot(position[0] - x, position[1] - y, position[2] - z), `seed ${seed}`).toBeLessThan(0.04);
        const dot = -Math.sin(yaw) * Math.cos(pitch) * direction[0] + Math.sin(pitch) * direction[1] - Math.cos(yaw) * Math.cos(pitch) * direction[2];
        expect(dot, `seed ${seed}`).toBeGreaterThan(Math.cos(0.01));
        expect(Math.hypot(...direction)).toBeCloseTo(1, 12);
      }
    }
  });

  it("comes out of a link to the last bit", () => {
    for (let seed = 0; seed < 20; seed++) {
      const { walk } = recorded(seed, 2 + 10 * seed);
      const text = encodeWalk(walk);
      expect([...decodeWalk(text).rows], `seed ${seed}`).toEqual([...walk.rows]);
      expect(encodeWalk(decodeWalk(text))).toBe(text);
    }
  });

  it("of a minute on foot fits a link", () => {
    const { walk } = recorded(7, 1600);
    expect(walk.lengthMs).toBeGreaterThan(55_000);
    expect(encodeWalk(walk).length).toBeLessThanOrEqual(LINK_CHARACTERS);
  });

  it("stops recording after ten minutes and at least two samples make one", () => {
    const recorder = new Recorder();
    recorder.start();
    expect(recorder.finish()).toBeNull();
    recorder.add(5, [0, 0, 0], 0, 0);
    expect(recorder.finish()).toBeNull();
    recorder.add(5 + LONGEST_MS + 999, [1, 0, 0], 0, 0);
    expect(recorder.full).toBe(true);
    recorder.add(5 + LONGEST_MS + 9999, [2, 0, 0], 0, 0);
    expect(decodeWalk(encodeWalk(recorder.finish()!)).lengthMs).toBe(LONGEST_MS);
  });

  it("has the same frames whatever the machine", () => {
    expect(new Walk(Float64Array.of(0, 0, 0, 0, 0, 0, 1000, 0, 0, 0, 0, 0)).frames).toBe(61);
    expect(new Walk(Float64Array.of(0, 0, 0, 0, 0, 0, 16, 0, 0, 0, 0, 0)).frames).toBe(1);
  });
});

describe("a damaged walk is refused by name", () => {
  const good = encodeWalk(recorded(3, 40).walk);

  it("when any character is another or missing", () => {
    for (let k = 0; k < good.length; k++) {
      const other = good.slice(0, k) + (good[k] === "A" ? "B" : "A") + good.slice(k + 1);
      // The unused low bits of the last character may differ without harm.
      if (k < good.length - 1) expect(() => decodeWalk(other), `character ${k}`).toThrow(WalkDamaged);
      expect(() => decodeWalk(good.slice(0, k)), `cut at ${k}`).toThrow(WalkDamaged);
    }
  });

  it("when it is something else", () => {
    const row = (...steps: number[]): number[] => steps;
    const wrong: Record<string, number[]> = {
      "no samples": [1, 0],
      "one sample": [1, 1, ...row(0, 0, 0, 0, 0, 0)],
      "more samples than bytes": [1, 255, 127, ...row(0, 0, 0, 0, 0, 0)],
      "time stands still": [1, 2, ...row(0, 0, 0, 0, 0, 0), ...row(0, 0, 0, 0, 0, 0)],
      "time does not begin at 0": [1, 2, ...row(2, 0, 0, 0, 0, 0), ...row(2, 0, 0, 0, 0, 0)],
      "bytes left over": [1, 2, ...row(0, 0, 0, 0, 0, 0), ...row(2, 0, 0, 0, 0, 0), 0],
      "a number without end": [1, 2, ...row(0, 0, 0, 0, 0, 0), ...row(2, 0, 0, 0, 0, 128)],
      "a number too large": [1, 2, 0, 255, 255, 255, 255, 255, 255, 255, 255, 1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0],
      "longer than ten minutes": [1, 2, ...row(0, 0, 0, 0, 0, 0), 130, 159, 73, 0, 0, 0, 0, 0],
      "looks over its shoulder from above": [1, 2, 0, 0, 0, 0, 0, 128, 130, 2, 2, 0, 0, 0, 0, 0],
    };
    for (const [name, bytes] of Object.entries(wrong)) expect(() => decodeWalk(sealed(bytes)), name).toThrow(WalkDamaged);
    for (const text of ["", "A", "%%", "é", "A".repeat(LINK_CHARACTERS + 1)]) expect(() => decodeWalk(text), text).toThrow(WalkDamaged);
    expect(() => decodeWalk(sealed([2, 2, ...row(0, 0, 0, 0, 0, 0), ...row(2, 0, 0, 0, 0, 0)]))).toThrow(WalkTooNew);
    expect(decodeWalk(sealed([1, 2, ...row(0, 0, 0, 0, 0, 0), ...row(2, 0, 0, 0, 0, 0)])).samples).toBe(2);
  });

  it("checks with the usual CRC-32", () => {
    expect(crc32(Buffer.from("123456789"))).toBe(0xcbf43926);
  });
});

describe("the log of a replay", () => {
  const facts = (reason: number, problemView = 4): FrameFacts => ({
    calls: 10, triangles: 200, impostors: 3, waiting: 1, missing: 0, cost: 1_500_000, geometryCost: 3_000_000, placementMs: 0.25, cell: 7, problemView, reason,
  });

  it("says why a frame is over budget", () => {
    expect(reasonOf(false, true, true, true)).toBe(WITHIN);
    expect(reasonOf(true, false, true, true)).toBe(UNPROMISED);
    expect(reasonOf(true, true, true, true)).toBe(STREAMING);
    expect(reasonOf(true, true, true, false)).toBe(HOPELESS);
    expect(reasonOf(true, true, false, false)).toBe(BROKEN);
  });

  it("is one line a frame, and leaves out what there is not", () => {
    const log = new WalkLog(3);
    log.add(facts(STREAMING));
    log.add(facts(WITHIN, -1));
    log.ms[0] = 12.5;
    const lines = walkCsv(log, STEP_MS).split("\r\n");
    expect(lines).toHaveLength(4); // with the header, and nothing after the last line's end
    expect(lines[1]).toBe("0,0.000,12.500,10,200,3,1,0,1500000,3000000,7,4,streaming,0.250");
    expect(lines[2]).toBe("1,16.667,,10,200,3,1,0,1500000,3000000,7,,,0.250");
    expect([log.overBudget, log.over(STREAMING), log.percentileMs(0.99)]).toEqual([1, 1, 12.5]);
  });

  it("becomes a picture without a number that is none", () => {
    const log = new WalkLog(30);
    for (let k = 0; k < 30; k++) log.add(facts(k % 7 ? WITHIN : STREAMING));
    log.ms.fill(9, 3, 20);
    for (const unit of ["ns", "calls"] as const) {
      const svg = walkPlot(log, STEP_MS, "a <b> & c", { unit, amount: 1_000_000 });
      expect(svg).toContain("a &lt;b&gt; &amp; c");
      expect(svg).not.toMatch(/NaN|Infinity|undefined/);
      expect(svg.match(/v8/g)).toHaveLength(5);
    }
    expect(walkPlot(new WalkLog(1), STEP_MS, "empty", { unit: "ns", amount: 0 })).not.toMatch(/NaN|Infinity/);
  });
});
