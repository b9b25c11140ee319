import { createHash } from "node:crypto";
import { afterEach, beforeEach, describe, expect, it } from "vitest";
import { Refused, Unreachable } from "./client";
import type { Scene } from "./types";
import { PIECE_BYTES, type SendPiece, uploadScene, type UploadStep } from "./upload";

/** A service in memory: what it has of files, by upload. */
class Service {
  uploads = new Map<string, { id: string; name: string; bytes: number; sha256: string; data: Uint8Array[]; problem: object | null }>();
  scenes = new Map<string, Scene>();
  asked: string[] = [];
  starts: number[] = [];

  received = (id: string): number => this.uploads.get(id)!.data.reduce((n, d) => n + d.length, 0);

  fetch = (address: string, init: RequestInit): Promise<Response> => {
    const url = new URL(address, "http://here");
    this.asked.push(`${init.method} ${url.pathname}`);
    const name = url.pathname.split("/").pop()!;
    if (url.pathname.startsWith("/v1/scenes/")) return answer(this.scenes.get(name));
    if (url.pathname === "/v1/uploads" && init.method === "GET")
      return answer({ uploads: [...this.uploads.values()].filter((u) => u.sha256 === url.searchParams.get("sha256")).map((u) => this.shown(u.id)) });
    if (url.pathname === "/v1/uploads") {
      const headers = init.headers as Record<string, string>;
      const told = Object.fromEntries(headers["upload-metadata"].split(",").map((p) => p.split(" ")));
      const id = `u${this.asked.length}`;
      const text = (key: string): string => Buffer.from(told[key], "base64").toString();
      this.uploads.set(id, { id, name: text("filename"), bytes: Number(headers["upload-length"]), sha256: text("sha256"), data: [], problem: null });
      return Promise.resolve(new Response(null, { status: 201, headers: { location: `/v1/uploads/${id}` } }));
    }
    return answer(this.uploads.has(name) ? this.shown(name) : undefined);
  };

  shown(id: string): object {
    const u = this.uploads.get(id)!;
    const received = this.received(id);
    return { ...u, data: undefined, received, state: u.problem ? "refused" : this.scenes.has(u.sha256) ? "done" : received === u.bytes ? "reading" : "open" };
  }

  /** Takes at most `most` bytes, then fails with `error`. */
  take(most = Infinity, error: Error | null = null): SendPiece {
    return async (id, piece, offset, went) => {
      const u = this.uploads.get(id);
      if (!u) throw new Refused({ status: 404 });
      expect(offset).toBe(this.received(id));
      this.starts.push(offset);
      const bytes = new Uint8Array(await piece.arrayBuffer()).slice(0, most);
      u.data.push(bytes);
      went(bytes.length);
      if (error) throw error;
      if (this.received(id) < u.bytes) return;
      const digest = createHash("sha256").update(Buffer.concat(u.data)).digest("hex");
      expect(digest).toBe(u.sha256);
      this.scenes.set(digest, { digest, name: u.name, bytes: u.bytes } as Scene);
    };
  }
}

const answer = (value: unknown): Promise<Response> =>
  Promise.resolve(value === undefined ? Response.json({ code: "None" }, { status: 404 }) : Response.json(value));

const LEVEL = new File([Uint8Array.from({ length: 100_000 }, (_, k) => k % 251)], "Städt'chen.glb");
const never = new AbortController().signal;
const plain = globalThis.fetch;
let service: Service;

beforeEach(() => {
  service = new Service();
  globalThis.fetch = service.fetch as typeof fetch;
});
afterEach(() => {
  globalThis.fetch = plain;
});

const run = (send: SendPiece, steps: UploadStep[] = [], signal = never): Promise<Scene> => uploadScene(LEVEL, (s) => steps.push(s), signal, send, 1);

describe("an upload", () => {
  it("asks for the digest first, sends once, and tells every step", async () => {
    const steps: UploadStep[] = [];
    expect((await run(service.take(), steps)).name).toBe("Städt'chen.glb");
    expect(service.asked[0]).toMatch(/^GET \/v1\/scenes\/[0-9a-f]{64}$/);
    expect(steps.map((s) => s.step)).toEqual(["hashing", "sending", "reading"]);
    const again: UploadStep[] = [];
    await run(() => Promise.reject(new Error("nothing is to be sent")), again);
    expect(again.at(-1)).toEqual({ step: "known" });
  });

  it("goes on where the line broke", async () => {
    const lines = [service.take(30_000, new Unreachable()), service.take(0, new Unreachable()), service.take(20_000, new Refused({ status: 502 })), service.take()];
    await run((...piece) => lines.shift()!(...piece));
    expect(service.starts).toEqual([0, 30_000, 30_000, 50_000]);
  });

  it("is found by its digest after the page was loaded again", async () => {
    await expect(run(service.take(40_000, new TypeError("the page is gone")))).rejects.toThrow("gone");
    const steps: UploadStep[] = [];
    await run(service.take(), steps);
    expect(service.starts).toEqual([0, 40_000]);
    expect(service.uploads.size).toBe(1);
    expect(steps.find((s) => s.step === "sending")).toMatchObject({ bytes: 40_000, total: 100_000 });
  });

  it("starts again where the service has forgotten it", async () => {
    const lines: SendPiece[] = [
      (id, ...rest) => service.take(10, new Refused({ status: 409 }))(id, ...rest).finally(() => service.uploads.delete(id)),
      service.take(),
    ];
    await run((...piece) => lines.shift()!(...piece));
    expect(service.starts).toEqual([0, 0]);
  });

  it("waits for as long as another request reads the file", async () => {
    let busy = 0;
    await run((...piece) => (++busy < 20 ? Promise.reject(new Refused({ status: 423 })) : service.take()(...piece)));
    expect(busy).toBe(20);
  });

  it("gives up on a service that is away, on a refusal, and when told", async () => {
    let tries = 0;
    await expect(run(() => (tries++, Promise.reject(new Unreachable())))).rejects.toThrow(Unreachable);
    expect(tries).toBe(8);
    await expect(run(() => Promise.reject(new Refused({ status: 422, code: "SceneEmpty" })))).rejects.toMatchObject({ code: "SceneEmpty" });
    for (const u of service.uploads.values()) u.problem = { status: 422, code: "SceneUnreadable", detail: "no", advice: "" };
    const abort = new AbortController();
    await expect(run(() => (abort.abort(new Error("stop")), Promise.reject(new Unreachable())), [], abort.signal)).rejects.toThrow("stop");
  });

  it("of a large file goes in pieces", async () => {
    const large = new File([new Uint8Array(PIECE_BYTES + 5)], "large.glb");
    await uploadScene(large, () => undefined, never, service.take(), 1);
    expect(service.starts).toEqual([0, PIECE_BYTES]);
  });
});
