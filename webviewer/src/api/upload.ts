/** A file sent once: hashed here, asked for by digest, sent only if unknown. XHR, because fetch tells no bytes sent. */
import { addressOf, csrfHeader, findScene, Refused, Unreachable } from "./client";
import { digestFile } from "./file_digest";
import type { Problem } from "./schema";
import type { Scene } from "./types";

export type UploadStep =
  | { step: "hashing"; bytes: number; total: number }
  | { step: "sending"; bytes: number; total: number; bytesPerSecond: number | null }
  | { step: "reading" } // all bytes are there; the service reads the level
  | { step: "known" }; // the service had this file already: nothing was sent

/** Sends the file unless it is known; returns what was read of it. Rejects with Refused, Unreachable or the abort. */
export async function uploadScene(file: File, tell: (step: UploadStep) => void, signal: AbortSignal): Promise<Scene> {
  tell({ step: "hashing", bytes: 0, total: file.size });
  const digest = await digestFile(file, (bytes) => tell({ step: "hashing", bytes, total: file.size }), signal);
  const known = await findScene(digest);
  signal.throwIfAborted();
  if (known) {
    tell({ step: "known" });
    return known;
  }
  return send(file, tell, signal);
}

function send(file: File, tell: (step: UploadStep) => void, signal: AbortSignal): Promise<Scene> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const began = performance.now();
    request.open("POST", addressOf("POST /v1/scenes"));
    request.responseType = "json";
    for (const [name, value] of Object.entries(csrfHeader())) request.setRequestHeader(name, value);
    request.setRequestHeader("content-type", "application/octet-stream");
    request.setRequestHeader("content-disposition", dispositionOf(file.name));
    request.upload.onprogress = (e) => {
      const seconds = (performance.now() - began) / 1000;
      tell({ step: "sending", bytes: e.loaded, total: file.size, bytesPerSecond: seconds > 0.5 ? e.loaded / seconds : null });
    };
    request.upload.onload = () => tell({ step: "reading" });
    request.onload = () => {
      if (request.status < 300) resolve(request.response as Scene);
      else reject(new Refused({ ...(request.response as Partial<Problem> | null), status: request.status }));
    };
    request.onerror = () => reject(new Unreachable());
    request.onabort = () => reject(signal.reason as Error);
    signal.addEventListener("abort", () => request.abort(), { once: true });
    tell({ step: "sending", bytes: 0, total: file.size, bytesPerSecond: null });
    request.send(file);
  });
}

/** RFC 6266: headers are Latin-1, so that any other name travels percent-encoded. */
export function dispositionOf(name: string): string {
  const encoded = encodeURIComponent(name).replace(/['()*]/g, (c) => `%${c.charCodeAt(0).toString(16).toUpperCase()}`);
  return `attachment; filename*=UTF-8''${encoded}`;
}
