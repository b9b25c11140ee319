import { createHash } from "node:crypto";
import { describe, expect, it } from "vitest";
import { addressOf } from "./client";
import { backoffMs, FrameParser } from "./event_stream";
import { digestFile, Sha256 } from "./file_digest";

const STREAM = ': farfield\nretry: 1000\n\nid: 7\nevent: shard\ndata: {"a": 1}\n\n: keepalive\n\nid: 8\r\nevent: job\r\ndata: one\r\ndata: two\r\n\r\nid: 9\ndata: three\n\n';

describe("frames of an event stream", () => {
  it("are the same wherever the text is cut", () => {
    const whole = new FrameParser().push(STREAM);
    expect(whole).toEqual([
      { id: "7", event: "shard", data: '{"a": 1}' },
      { id: "8", event: "job", data: "one\ntwo" },
      { id: "9", event: "message", data: "three" },
    ]);
    for (let cut = 0; cut <= STREAM.length; cut++) {
      const parser = new FrameParser();
      expect([...parser.push(STREAM.slice(0, cut)), ...parser.push(STREAM.slice(cut))], `cut at ${cut}`).toEqual(whole);
    }
  });

  it("wait longer after each failure, up to about ten seconds", () => {
    const waits = Array.from({ length: 8 }, (_, k) => backoffMs(k, 0));
    expect(waits).toEqual([500, 1000, 2000, 4000, 8000, 8000, 8000, 8000]);
    expect(backoffMs(9, 1)).toBe(9600);
  });
});

describe("digests of files", () => {
  it("are SHA-256, in pieces of any size", () => {
    for (const size of [0, 1, 55, 56, 63, 64, 65, 119, 120, 1000, 4097]) {
      const bytes = Uint8Array.from({ length: size }, (_, k) => (k * 31 + size) & 255);
      const expected = createHash("sha256").update(bytes).digest("hex");
      for (const piece of [1, 7, 64, 100, 5000]) {
        const digest = new Sha256();
        for (let at = 0; at < size; at += piece) digest.update(bytes.subarray(at, at + piece));
        expect(digest.hex(), `${size} bytes in pieces of ${piece}`).toBe(expected);
      }
    }
  });

  it("tell how far they are, and stop when told", async () => {
    const subtle = Object.getOwnPropertyDescriptor(globalThis, "crypto")!;
    Object.defineProperty(globalThis, "crypto", { value: undefined, configurable: true }); // as on plain http
    try {
      const blob = new Blob([new Uint8Array(3 << 20)]);
      const seen: number[] = [];
      const hex = await digestFile(blob, (n) => seen.push(n), new AbortController().signal);
      expect(hex).toBe(createHash("sha256").update(new Uint8Array(3 << 20)).digest("hex"));
      expect(seen).toEqual([1 << 20, 2 << 20, 3 << 20]);
      await expect(digestFile(blob, () => undefined, AbortSignal.abort(new Error("stop")))).rejects.toThrow("stop");
    } finally {
      Object.defineProperty(globalThis, "crypto", subtle);
    }
  });
});

describe("addresses", () => {
  it("escape what is put into them", () => {
    expect(addressOf("GET /v1/jobs/{job_id}", { job_id: "a/b?c" })).toBe("/v1/jobs/a%2Fb%3Fc");
    expect(addressOf("GET /v1/placements/{placement}/{path}", { placement: "x y", path: "chunks/a.ffc" })).toBe("/v1/placements/x%20y/chunks/a.ffc");
    expect(addressOf("GET /v1/jobs", {}, { limit: 5, cursor: "a=b" })).toBe("/v1/jobs?limit=5&cursor=a%3Db");
  });
});
