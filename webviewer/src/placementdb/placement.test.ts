/** The same golden trees and answers as tests/services/placementdb: both readers agree, or one of them is wrong. */
import { existsSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { deflateSync, inflateSync } from "node:zlib";
import { describe, expect, it, vi } from "vitest";
import { unpack } from "./columns";
import { Placement, viewsServed, type FetchBytes } from "./placement";
import { sha256, sha256Plain } from "./sha256";
import { unpackFile } from "./squeeze";

const GOLDEN = resolve(import.meta.dirname, "../../../tests/golden");
const TREES = ["placementdb", "placementdb-visible", "placementdb-detail", "placementdb-ktx2"];

type Change = (name: string, bytes: Uint8Array) => Uint8Array | null;

function reads(tree: string, change: Change = (_, b) => b): FetchBytes {
  return async (name) => {
    const path = join(GOLDEN, tree, name);
    return existsSync(path) ? change(name, new Uint8Array(readFileSync(path))) : null;
  };
}

/** Writes the manifest anew with a valid seal, so that what follows the digest is tested too. */
async function resealed(bytes: Uint8Array, edit: (m: Record<string, any>) => void): Promise<Uint8Array> {
  const manifest = JSON.parse(new TextDecoder().decode(bytes));
  edit(manifest);
  manifest.manifest_sha256 = "0".repeat(64);
  const text = JSON.stringify(manifest);
  return new TextEncoder().encode(text.replace("0".repeat(64), await sha256(new TextEncoder().encode(text))));
}

describe.each(TREES)("%s", (tree) => {
  const golden = JSON.parse(readFileSync(join(GOLDEN, tree, "lookups.json"), "utf8"));

  it("gives Python's answers", async () => {
    const placement = await Placement.open(reads(tree));
    expect(golden.lookups.length).toBeGreaterThan(20);
    for (const g of golden.lookups) {
      const a = await placement.lookup(g.position, g.direction);
      expect({ ...g, ...{ cell: a.cell, interval: a.interval, problem_view: a.problemView, hopeless: a.hopeless, objects: a.objects, levels: a.levels, impostors: a.impostors, cost_bound: a.costBound } }).toEqual(g);
    }
  });

  it("refuses what Python refuses", async () => {
    const placement = await Placement.open(reads(tree));
    for (const p of golden.outside) await expect(placement.lookup(p, [0, 0, -1])).rejects.toMatchObject({ code: "OutsideViewSpace" });
    const inside = golden.lookups[0].position;
    for (const d of [...golden.bad_directions, [Number.NaN, 0, 1], [Infinity, 0, 0]]) {
      await expect(placement.lookup(inside, d)).rejects.toMatchObject({ code: "DirectionInvalid" });
    }
  });

  it("counts the views an impostor serves, of the chunks that are here", async () => {
    const placement = await Placement.open(reads(tree));
    expect(viewsServed(placement, 0)).toEqual({ views: 0, all: placement.manifest.chunks.length === 0 });
    const shown = new Map<number, number>();
    for (let number = 0; number < placement.manifest.chunks.length; number++) {
      const chunk = await placement.chunk(number);
      for (const list of chunk.viewList) {
        for (let k = chunk.listRow[list]; k < chunk.listRow[list + 1]; k++) {
          const id = chunk.impostorId[chunk.listImpostor[k]];
          shown.set(id, (shown.get(id) ?? 0) + 1);
        }
      }
    }
    expect(shown.size).toBeGreaterThan(0);
    for (let id = 0; id < placement.manifest.counts.impostors; id++) {
      expect(viewsServed(placement, id)).toEqual({ views: shown.get(id) ?? 0, all: true });
    }
  });

  it("puts squeezed columns together as Python does", async () => {
    const manifest = JSON.parse(readFileSync(join(GOLDEN, tree, "manifest.json"), "utf8"));
    const g = manifest.geometry;
    const entries = [manifest.index, ...manifest.chunks, ...(g ? [g.index, ...g.pages] : [])];
    expect(entries.map((e) => e.file).sort()).toEqual(Object.keys(golden.columns).sort());
    for (const { file, expanded } of entries) {
      const bytes = new Uint8Array(readFileSync(join(GOLDEN, tree, file)));
      const { columns } = await unpackFile(bytes, file, expanded);
      const found: Record<string, string> = {};
      for (const [name, { data }] of columns) found[name] = await sha256(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
      expect(found).toEqual(golden.columns[file]);
      await expect(unpackFile(bytes, file, expanded - 1)).rejects.toMatchObject({ code: "ColumnsAltered" });
      await expect(unpackFile(bytes, file, expanded + 1)).rejects.toMatchObject({ code: "ColumnsTruncated" });
    }
  });

  it("checks whole", async () => {
    await (await Placement.open(reads(tree))).check();
  });

  it("takes a file that came damaged once more, past every cache, and no file more often than that", async () => {
    const asked: [string, boolean][] = [];
    const files = reads(tree);
    const placement = await Placement.open(async (name, signal, anew = false) => {
      asked.push([name, anew]);
      const bytes = await files(name, signal);
      return bytes && !anew && name !== "manifest.json" ? bytes.subarray(0, bytes.length - 1) : bytes;
    });
    const file = placement.manifest.index.file;
    expect(asked).toEqual([["manifest.json", false], [file, false], [file, true]]);
    await placement.check();
  });

  it("refuses every altered, truncated or missing file and names it", async () => {
    const names = ["manifest.json"];
    const manifest = JSON.parse(readFileSync(join(GOLDEN, tree, "manifest.json"), "utf8"));
    const g = manifest.geometry;
    const level = g ? [g.index, ...g.pages, ...g.textures] : [];
    for (const entry of [manifest.index, ...manifest.chunks, ...manifest.pages, ...level]) names.push(entry.file);
    const open = async (change: Change): Promise<void> => (await Placement.open(reads(tree, change))).check();
    for (const name of names) {
      const only = (f: (b: Uint8Array) => Uint8Array | null): Change => (n, b) => (n === name ? f(b) : b);
      const length = readFileSync(join(GOLDEN, tree, name)).length;
      for (let k = 0; k < 12; k++) {
        const at = Math.floor((length * (k + 0.5)) / 12);
        const cut = open(only((b) => b.slice(0, at)));
        await expect(cut).rejects.toMatchObject({ code: "ColumnsTruncated", where: name, message: expect.stringContaining(name) });
        const flipped = open(only((b) => b.map((x, i) => (i === at ? x ^ 1 : x))));
        await expect(flipped).rejects.toMatchObject({ where: name, code: expect.stringMatching(/ColumnsAltered|NotColumns|ColumnsTooNew/) });
      }
      await expect(open(only(() => null))).rejects.toMatchObject({ code: "PlacementFileMissing", where: name });
      if (name !== "manifest.json") {
        await expect(open(only((b) => new Uint8Array([...b, 0])))).rejects.toMatchObject({ code: "ColumnsAltered", where: name });
      }
    }
  });

  it("refuses a newer manifest, a foreign one, and one that lies with a valid seal", async () => {
    const bytes = new Uint8Array(readFileSync(join(GOLDEN, tree, "manifest.json")));
    const open = async (edit: (m: Record<string, any>) => void): Promise<unknown> => {
      const changed = await resealed(bytes, edit);
      return Placement.open(reads(tree, (n, b) => (n === "manifest.json" ? changed : b)));
    };
    await open(() => {});
    await expect(open((m) => (m.version = 7))).rejects.toMatchObject({ code: "ColumnsTooNew", message: expect.stringContaining("version 7") });
    await expect(open((m) => (m.format = "other"))).rejects.toMatchObject({ code: "NotColumns" });
    await expect(open((m) => (m.index.file = "../secret"))).rejects.toMatchObject({ code: "ColumnsAltered" });
    await expect(open((m) => (m.chunks[0].cells = [5, 1e9]))).rejects.toMatchObject({ code: "ColumnsAltered" });
    await expect(open((m) => (m.interval_edges = [1, -1]))).rejects.toMatchObject({ code: "ColumnsAltered" });
    await expect(open((m) => (m.counts.objects += 1))).rejects.toMatchObject({ code: "ColumnsAltered" });
  });
});

describe("the container", () => {
  const manifest = JSON.parse(readFileSync(join(GOLDEN, TREES[0], "manifest.json"), "utf8"));
  const bytes = new Uint8Array(inflateSync(readFileSync(join(GOLDEN, TREES[0], manifest.index.file))));
  it("refuses every truncation with its own name, and a newer version", () => {
    for (let n = 0; n < bytes.length; n += 97) {
      expect(() => unpack(bytes.slice(0, n), "x")).toThrow(n < 16 ? /not a farfield file/ : /truncated/);
    }
    const newer = bytes.slice();
    newer[8] = 9;
    expect(() => unpack(newer, "x")).toThrow(/format version 9/);
  });
  it("never reads past its end, whatever a header byte says", () => {
    const head = new DataView(bytes.buffer, bytes.byteOffset).getUint32(12, true);
    for (let at = 16; at < 16 + head; at++) {
      for (const value of [0x30, 0x39, 0x2d, 0x22]) {
        const bad = bytes.slice();
        bad[at] = value;
        try {
          for (const { shape, data } of unpack(bad, "x").columns.values()) {
            expect(data.length).toBe(shape.reduce((a, b) => a * b, 1));
          }
        } catch (error) {
          expect((error as { code: string }).code).toMatch(/ColumnsAltered|ColumnsTruncated|NotColumns/);
        }
      }
    }
  });
  it("stops inflating where a file becomes longer than the manifest says", async () => {
    let inflated = 0;
    class Counted {
      readonly readable: ReadableStream;
      readonly writable: WritableStream;
      constructor(format: CompressionFormat) {
        const { readable, writable } = new RealStream(format);
        const count = new TransformStream<Uint8Array>({
          transform(part, out) {
            inflated += part.length;
            out.enqueue(part);
          },
        });
        this.writable = writable;
        this.readable = readable.pipeThrough(count);
      }
    }
    const RealStream = DecompressionStream;
    vi.stubGlobal("DecompressionStream", Counted);
    try {
      const bomb = new Uint8Array(deflateSync(new Uint8Array(64e6)));
      await expect(unpackFile(bomb, "x.ffz", 1000)).rejects.toMatchObject({ code: "ColumnsAltered", message: expect.stringContaining("1000 bytes") });
    } finally {
      vi.unstubAllGlobals();
    }
    expect(inflated).toBeGreaterThan(1000);
    expect(inflated).toBeLessThan(4e6);
  });
  it("digests alike with and without crypto.subtle", async () => {
    for (const n of [0, 1, 55, 56, 63, 64, 65, 1000]) {
      const data = bytes.slice(0, n);
      expect(sha256Plain(data)).toBe(await sha256(data));
    }
  });
});
