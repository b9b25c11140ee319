/**
 * SHA-256 of a file, piece by piece: crypto.subtle wants all bytes at once, and a level may be larger than memory.
 * Small files go to crypto.subtle, where there is one (secure contexts only).
 */
import { sha256 } from "../placementdb/sha256";

const PIECE_BYTES = 1 << 20;
const WHOLE_BYTES = 64 << 20;

const ROUND = new Uint32Array(64);
const START = new Uint32Array(8);
// FIPS 180-4: first 32 bits of the fractional parts of the cube and square roots of the first primes.
for (let n = 2, k = 0; k < 64; n++) {
  let prime = true;
  for (let d = 2; d * d <= n; d++) prime &&= n % d !== 0;
  if (!prime) continue;
  if (k < 8) START[k] = (Math.sqrt(n) % 1) * 2 ** 32;
  ROUND[k++] = (Math.cbrt(n) % 1) * 2 ** 32;
}

/** The digest so far. */
export class Sha256 {
  private readonly state = START.slice();
  private readonly words = new Int32Array(64);
  private readonly block = new Uint8Array(64);
  private filled = 0;
  private length = 0;

  update(bytes: Uint8Array): void {
    this.length += bytes.length;
    let at = 0;
    if (this.filled) {
      at = Math.min(64 - this.filled, bytes.length);
      this.block.set(bytes.subarray(0, at), this.filled);
      this.filled += at;
      if (this.filled < 64) return;
      this.mix(this.block, 0);
    }
    for (; at + 64 <= bytes.length; at += 64) this.mix(bytes, at);
    this.block.set(bytes.subarray(at));
    this.filled = bytes.length - at;
  }

  /** 64 hex digits; the object is used up. */
  hex(): string {
    const bits = this.length;
    const pad = new Uint8Array(((this.filled < 56 ? 56 : 120) - this.filled) + 8);
    pad[0] = 0x80;
    const view = new DataView(pad.buffer);
    view.setUint32(pad.length - 8, Math.floor(bits / 2 ** 29));
    view.setUint32(pad.length - 4, (bits << 3) >>> 0);
    this.update(pad);
    return Array.from(this.state, (word) => word.toString(16).padStart(8, "0")).join("");
  }

  private mix(b: Uint8Array, at: number): void {
    const w = this.words;
    const h = this.state;
    for (let i = 0, p = at; i < 16; i++, p += 4) w[i] = (b[p] << 24) | (b[p + 1] << 16) | (b[p + 2] << 8) | b[p + 3];
    for (let i = 16; i < 64; i++) {
      const x = w[i - 15];
      const y = w[i - 2];
      const s0 = ((x >>> 7) | (x << 25)) ^ ((x >>> 18) | (x << 14)) ^ (x >>> 3);
      const s1 = ((y >>> 17) | (y << 15)) ^ ((y >>> 19) | (y << 13)) ^ (y >>> 10);
      w[i] = (w[i - 16] + s0 + w[i - 7] + s1) | 0;
    }
    let a = h[0] | 0, q = h[1] | 0, c = h[2] | 0, d = h[3] | 0, e = h[4] | 0, f = h[5] | 0, g = h[6] | 0, k = h[7] | 0;
    for (let i = 0; i < 64; i++) {
      const s1 = ((e >>> 6) | (e << 26)) ^ ((e >>> 11) | (e << 21)) ^ ((e >>> 25) | (e << 7));
      const t1 = (k + s1 + ((e & f) ^ (~e & g)) + ROUND[i] + w[i]) | 0;
      const s0 = ((a >>> 2) | (a << 30)) ^ ((a >>> 13) | (a << 19)) ^ ((a >>> 22) | (a << 10));
      const t2 = (s0 + ((a & q) ^ (a & c) ^ (q & c))) | 0;
      k = g; g = f; f = e; e = (d + t1) | 0; d = c; c = q; q = a; a = (t1 + t2) | 0;
    }
    h[0] += a; h[1] += q; h[2] += c; h[3] += d; h[4] += e; h[5] += f; h[6] += g; h[7] += k;
  }
}

/** Digest of a file; `progress` hears bytes done. Rejects with the signal's reason when aborted. */
export async function digestFile(file: Blob, progress: (bytes: number) => void, signal: AbortSignal): Promise<string> {
  if (file.size <= WHOLE_BYTES && globalThis.crypto?.subtle) return sha256(new Uint8Array(await file.arrayBuffer()));
  const digest = new Sha256();
  for (let at = 0; at < file.size; at += PIECE_BYTES) {
    signal.throwIfAborted();
    digest.update(new Uint8Array(await file.slice(at, at + PIECE_BYTES).arrayBuffer()));
    progress(Math.min(at + PIECE_BYTES, file.size));
  }
  return digest.hex();
}
