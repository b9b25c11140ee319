/**
 * A file sent once: hashed here, asked for by digest, sent only if unknown, and from where it stopped.
 *
 * tus 1.0.0. The service finds an upload by the file's digest: after a lost connection, a reload of the page or on another
 * machine the same file goes on at the bytes that have arrived, and nothing is kept here. XHR, because fetch tells no bytes
 * sent. A line that breaks is tried again for as long as new bytes arrive now and then.
 */
import { addressOf, csrfHeader, findScene, findUploads, readUpload, Refused, startUpload, Unreachable } from "./client";
import { digestFile } from "./file_digest";
import type { Problem } from "./schema";
import type { Scene } from "./types";

export type UploadStep =
  | { step: "hashing"; bytes: number; total: number }
  | { step: "sending"; bytes: number; total: number; bytesPerSecond: number | null }
  | { step: "reading" } // all bytes are there; the service reads the level
  | { step: "known" }; // the service had this file already: nothing was sent

/** Sends a piece from `offset` on and tells how many of its bytes went; resolves to the answer's status. */
export type SendPiece = (upload: string, piece: Blob, offset: number, went: (bytes: number) => void, signal: AbortSignal) => Promise<void>;

export const PIECE_BYTES = 32 << 20; // what a proxy holds back until it is whole is soon on its way
const FAILURES = 8; // one after another, without a new byte
const AGAIN = [404, 408, 409, 423, 502, 503, 504]; // 423: another request reads it, which may take minutes

/** Sends the file unless it is known; returns what was read of it. Rejects with Refused, Unreachable or the abort. */
export async function uploadScene(
  file: File, tell: (step: UploadStep) => void, signal: AbortSignal, sendPiece: SendPiece = sendByXhr, pauseMs = 500,
): Promise<Scene> {
  tell({ step: "hashing", bytes: 0, total: file.size });
  const digest = await digestFile(file, (bytes) => tell({ step: "hashing", bytes, total: file.size }), signal);
  const known = await findScene(digest);
  signal.throwIfAborted();
  if (known) {
    tell({ step: "known" });
    return known;
  }
  let upload = (await findUploads(digest)).find((u) => u.bytes === file.size && (u.state === "open" || u.state === "reading")) ?? null;
  let most = -1;
  let failures = 0;
  let speed: Speed | null = null;
  for (;;) {
    signal.throwIfAborted();
    try {
      upload ??= await startUpload(file, digest, signal);
      if (failures) upload = await readUpload(upload.id, signal);
      if (upload.problem) throw new Refused(upload.problem);
      if (upload.state === "done") return (await findScene(digest))!;
      const at = upload.received;
      if (at > most) [most, failures] = [at, 0];
      speed ??= new Speed(at);
      const piece = file.slice(at, Math.min(at + PIECE_BYTES, file.size));
      const progress = (went: number): void => {
        if (at + went >= file.size) tell({ step: "reading" });
        else tell({ step: "sending", bytes: at + went, total: file.size, bytesPerSecond: speed!.at(at + went) });
      };
      progress(0);
      await sendPiece(upload.id, piece, at, progress, signal);
      upload = await readUpload(upload.id, signal);
    } catch (error) {
      signal.throwIfAborted();
      const again = error instanceof Unreachable || (error instanceof Refused && AGAIN.includes(error.status));
      if (!again || (++failures >= FAILURES && !(error instanceof Refused && error.status === 423))) throw error;
      if (error instanceof Refused && error.status === 404) upload = null; // it has expired, or somebody has ended it
      await pause(Math.min(pauseMs * 2 ** (failures - 1), 20 * pauseMs), signal);
    }
  }
}

/** Bytes a second since the first byte that this page sent. */
class Speed {
  private readonly began = performance.now();
  constructor(private readonly first: number) {}
  at(bytes: number): number | null {
    const seconds = (performance.now() - this.began) / 1000;
    return seconds > 0.5 && bytes > this.first ? (bytes - this.first) / seconds : null;
  }
}

function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(() => (signal.removeEventListener("abort", stop), resolve()), milliseconds);
    const stop = (): void => (clearTimeout(timer), reject(signal.reason as Error));
    signal.addEventListener("abort", stop, { once: true });
  });
}

const sendByXhr: SendPiece = (upload, piece, offset, went, signal) =>
  new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const abort = (): void => request.abort();
    request.open("PATCH", addressOf("PATCH /v1/uploads/{upload_id}", { upload_id: upload }));
    const headers = { ...csrfHeader(), "tus-resumable": "1.0.0", "upload-offset": String(offset), "content-type": "application/offset+octet-stream" };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = (e) => went(e.loaded);
    request.upload.onload = () => went(piece.size);
    request.onload = () => (request.status < 300 ? resolve() : reject(refusalOf(request)));
    request.onerror = () => reject(new Unreachable());
    request.onabort = () => reject(signal.reason as Error);
    request.onloadend = () => signal.removeEventListener("abort", abort);
    signal.addEventListener("abort", abort, { once: true });
    request.send(piece);
  });

function refusalOf(request: XMLHttpRequest): Refused {
  let problem: Partial<Problem> = {};
  try {
    problem = JSON.parse(request.responseText) as Partial<Problem>;
  } catch {
    // a proxy's page: the status says enough
  }
  return new Refused({ ...problem, status: request.status });
}

