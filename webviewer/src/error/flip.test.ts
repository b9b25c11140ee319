/** Against the flip-evaluator package, on the pictures of tests/golden/flip (made by make_flip.py there). */
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
import { describe, expect, it } from "vitest";
import { flip } from "./flip";

interface Case {
  name: string;
  width: number;
  height: number;
  truth: string; // RGB, base64
  shown: string;
  mean: number;
  error: number[]; // row by row
}

const path = resolve(import.meta.dirname, "../../../tests/golden/flip/flip.json");
const cases = JSON.parse(readFileSync(path, "utf8")) as Case[];

function rgba(base64: string): Uint8Array {
  const rgb = Buffer.from(base64, "base64");
  return Uint8Array.from({ length: (4 * rgb.length) / 3 }, (_, i) => (i % 4 === 3 ? 255 : rgb[3 * (i >> 2) + (i % 4)]));
}

describe("flip", () => {
  it.each(cases)("agrees with flip-evaluator on $name, pixel by pixel", ({ width, height, truth, shown, mean, error }) => {
    const found = flip(rgba(truth), rgba(shown), width, height);
    expect(found.mean).toBeCloseTo(mean, 4);
    let worst = 0;
    for (let i = 0; i < error.length; i++) worst = Math.max(worst, Math.abs(found.error[i] - error[i]));
    expect(worst).toBeLessThan(2e-3); // the package computes in float32
    expect(found.error.length).toBe(error.length);
  });

  it("is the same either way round and 0 between equals", () => {
    const { width, height, truth, shown } = cases[0];
    const [a, b] = [rgba(truth), rgba(shown)];
    expect(flip(b, a, width, height).mean).toBeCloseTo(flip(a, b, width, height).mean, 6);
    expect(flip(a, a, width, height).mean).toBe(0);
  });

  it("refuses pictures of another size", () => {
    expect(() => flip(new Uint8Array(4), new Uint8Array(8), 1, 1)).toThrow(RangeError);
  });
});
