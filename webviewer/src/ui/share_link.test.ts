import { describe, expect, it } from "vitest";
import { Walk } from "../walk/walk";
import { readShared, sharedFragment, type Shared } from "./share_link";

const walk = new Walk(Float64Array.of(0, 1500, 1700, -20, 12, 0, 4000, 9500, 1700, -20, 70000, -12));
const all: Shared = {
  view: { position: [1 / 3, 1.7, -1e-9], direction: [0, 0.1, -1] }, show: "ixl", cut: 0.37, held: { cell: 12, interval: 95 }, walk,
};

describe("a shared link", () => {
  it("holds view, toggles, held cell and walk to the last bit", () => {
    expect(readShared(sharedFragment(all))).toEqual({ ...all, refused: "" });
  });

  it("leaves out what it does not hold", () => {
    const nothing: Shared = { view: null, show: null, cut: null, held: null, walk: null };
    expect(sharedFragment(nothing)).toBe("#");
    expect(readShared("#")).toEqual({ ...nothing, refused: "" });
    expect(readShared("#show=").show).toBe("");
  });

  it("keeps the rest when the walk is damaged, and says so by name", () => {
    const damaged = sharedFragment(all).slice(0, -2);
    const read = readShared(damaged);
    expect(read.walk).toBeNull();
    expect(read.refused).toContain("cannot be read");
    expect(read.view).toEqual(all.view);
    expect(read.show).toBe("ixl");
  });

  it("takes nothing that is out of range", () => {
    const read = readShared("#show=zzlq!&cut=7&held=1.2.3&at=1,2&to=0,0,0");
    expect(read).toEqual({ view: null, show: "l", cut: null, held: null, walk: null, refused: "" });
  });
});
