/**
 * A walk: where the camera was and where it looked, at times in milliseconds. Recorded, replayed at fixed steps, and small enough for a link.
 *
 * Problem  The same link must give the same frames on any machine, and 10 minutes must fit into an address.
 * Method   Whole numbers from the start: milliseconds, millimetres, 1/65536 of a turn. Of the recorded samples those stay without which
 *          a straight line between its neighbours would be off by more than a tolerance; the tolerance doubles until the link is short
 *          enough. What is replayed is always what the link says, also right after recording.
 *          Bytes: version, sample count, then for each sample the differences to the one before as zigzag varints, then CRC-32; base64url.
 */
import type { Vec3 } from "../placementdb/manifest";

export const WALK_VERSION = 1;
export const LINK_CHARACTERS = 6000; // of the walk: addresses of 8,000 pass everywhere
export const LONGEST_MS = 600_000;
export const STEP_MS = 1000 / 60;
const TURN = 65536;
const COLUMNS = 6; // time, x, y, z, yaw, pitch
const MOST_SAMPLES = 20_000;
const MOST = 2 ** 40; // of any number: far from where float64 stops being exact

/** Why a walk in a link is refused. */
export class WalkDamaged extends Error {
  constructor(why: string) {
    super(`The walk in this link cannot be read: ${why}. Copy the link again from where it came.`);
    this.name = "WalkDamaged";
  }
}

export class WalkTooNew extends Error {
  constructor(version: number) {
    super(`The walk in this link has version ${version}; this page reads version ${WALK_VERSION}. Reload the page, or open the link where it was made.`);
    this.name = "WalkTooNew";
  }
}

export class WalkTooLong extends Error {
  constructor(what: string) {
    super(`The walk is too long for a link: ${what}. Record a shorter one.`);
    this.name = "WalkTooLong";
  }
}

/** Rows of (ms, mm, mm, mm, yaw, pitch), all whole; times rise from 0. Yaw is not wrapped: it may pass a full turn. */
export class Walk {
  readonly rows: Float64Array;
  readonly samples: number;

  constructor(rows: Float64Array) {
    this.rows = rows;
    this.samples = rows.length / COLUMNS;
  }

  get lengthMs(): number {
    return this.rows[COLUMNS * (this.samples - 1)];
  }

  /** Frames of a replay: one at 0, then every STEP_MS up to the end. */
  get frames(): number {
    return Math.floor(this.lengthMs / STEP_MS + 1e-9) + 1;
  }

  /** Position and unit direction at a time, held at both ends, into `position` and `direction`. */
  at(ms: number, position: Vec3, direction: Vec3): void {
    const { rows } = this;
    let low = 0;
    let high = this.samples - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (rows[COLUMNS * middle] <= ms) low = middle;
      else high = middle;
    }
    const [a, b] = [COLUMNS * low, COLUMNS * high];
    const span = rows[b] - rows[a];
    const t = span > 0 ? Math.min(1, Math.max(0, (ms - rows[a]) / span)) : 0;
    for (let k = 0; k < 3; k++) position[k] = (rows[a + 1 + k] + t * (rows[b + 1 + k] - rows[a + 1 + k])) / 1000;
    const yaw = ((rows[a + 4] + t * (rows[b + 4] - rows[a + 4])) * 2 * Math.PI) / TURN;
    const pitch = ((rows[a + 5] + t * (rows[b + 5] - rows[a + 5])) * 2 * Math.PI) / TURN;
    direction[0] = -Math.sin(yaw) * Math.cos(pitch);
    direction[1] = Math.sin(pitch);
    direction[2] = -Math.cos(yaw) * Math.cos(pitch);
  }
}

/** Takes samples while somebody walks, into arrays that never grow. */
export class Recorder {
  private readonly rows = new Float64Array(COLUMNS * MOST_SAMPLES);
  private n = 0;
  private startMs = 0;
  private turns = 0;
  private lastYaw = 0;

  get ms(): number {
    return this.n ? this.rows[COLUMNS * (this.n - 1)] : 0;
  }

  get full(): boolean {
    return this.n >= MOST_SAMPLES || this.ms >= LONGEST_MS;
  }

  start(): void {
    this.n = 0;
    this.turns = 0;
  }

  /** Position in metres, yaw and pitch in radians; samples less than 25 ms after the last are left out. */
  add(nowMs: number, position: ArrayLike<number>, yaw: number, pitch: number): void {
    if (this.full) return;
    if (!this.n) this.startMs = nowMs;
    const ms = Math.round(nowMs - this.startMs);
    if (this.n && ms - this.ms < 25) return;
    if (this.n) this.turns -= Math.round((yaw - this.lastYaw) / (2 * Math.PI)); // the short way round
    this.lastYaw = yaw;
    const at = COLUMNS * this.n++;
    this.rows[at] = Math.min(ms, LONGEST_MS);
    for (let k = 0; k < 3; k++) this.rows[at + 1 + k] = whole(1000 * position[k]);
    this.rows[at + 4] = whole((yaw / (2 * Math.PI) + this.turns) * TURN);
    this.rows[at + 5] = whole((pitch / (2 * Math.PI)) * TURN);
  }

  /** The walk as a link can hold it; null where nothing was recorded. `WalkTooLong`. */
  finish(): Walk | null {
    if (this.n < 2) return null;
    const all = this.rows.subarray(0, COLUMNS * this.n);
    for (let tolerance = 1; tolerance <= 64; tolerance *= 2) {
      const walk = new Walk(thinned(all, tolerance));
      if (text(walk).length <= LINK_CHARACTERS) return walk;
    }
    throw new WalkTooLong(`${this.n} samples of it do not fit`);
  }
}

/** Rounded, and never -0, which a link cannot tell from 0. */
function whole(x: number): number {
  return Math.round(x) + 0;
}

/** At tolerance 1 a sample may be off by 5 mm and by 0.06 degrees. */
function thinned(rows: Float64Array, tolerance: number): Float64Array {
  const allowed = [0, 5, 5, 5, 10, 10].map((x) => x * tolerance);
  const kept = [0];
  const n = rows.length / COLUMNS;
  const split = (a: number, b: number): void => {
    // Iterative halving at the worst sample (Douglas and Peucker), left part first.
    const stack = [[a, b]];
    while (stack.length) {
      const [low, high] = stack.pop()!;
      let worst = 1;
      let at = -1;
      for (let i = low + 1; i < high; i++) {
        const t = (rows[COLUMNS * i] - rows[COLUMNS * low]) / (rows[COLUMNS * high] - rows[COLUMNS * low]);
        for (let k = 1; k < COLUMNS; k++) {
          const line = rows[COLUMNS * low + k] + t * (rows[COLUMNS * high + k] - rows[COLUMNS * low + k]);
          const off = Math.abs(rows[COLUMNS * i + k] - line) / allowed[k];
          if (off > worst) [worst, at] = [off, i];
        }
      }
      if (at < 0) kept.push(high);
      else stack.push([at, high], [low, at]);
    }
  };
  split(0, n - 1);
  const out = new Float64Array(COLUMNS * kept.length);
  kept.forEach((i, k) => out.set(rows.subarray(COLUMNS * i, COLUMNS * (i + 1)), COLUMNS * k));
  return out;
}

/** The walk for a link. `WalkTooLong` beyond LINK_CHARACTERS. */
export function encodeWalk(walk: Walk): string {
  const out = text(walk);
  if (out.length > LINK_CHARACTERS) throw new WalkTooLong(`${out.length} characters of at most ${LINK_CHARACTERS}`);
  return out;
}

function text(walk: Walk): string {
  const out = [WALK_VERSION];
  const varint = (value: number): void => {
    for (; value >= 128; value = Math.floor(value / 128)) out.push((value % 128) | 128);
    out.push(value);
  };
  varint(walk.samples);
  for (let i = 0; i < walk.rows.length; i++) {
    const step = walk.rows[i] - (i >= COLUMNS ? walk.rows[i - COLUMNS] : 0);
    varint(step < 0 ? -2 * step - 1 : 2 * step);
  }
  const sum = crc32(out);
  for (let k = 0; k < 4; k++) out.push((sum >>> (8 * k)) & 255);
  return btoa(String.fromCharCode(...out)).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

/** What encodeWalk wrote. `WalkDamaged`, `WalkTooNew`. */
export function decodeWalk(encoded: string): Walk {
  if (encoded.length > LINK_CHARACTERS) throw new WalkDamaged(`it has ${encoded.length} characters of at most ${LINK_CHARACTERS}`);
  if (!/^[\w-]+$/.test(encoded)) throw new WalkDamaged("it holds characters that no walk has");
  let bytes: Uint8Array;
  try {
    bytes = Uint8Array.from(atob(encoded.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0));
  } catch {
    throw new WalkDamaged("it is cut off");
  }
  const body = bytes.subarray(0, -4);
  if (bytes.length < 6) throw new WalkDamaged("it is cut off");
  const stated = bytes.subarray(-4).reduce((sum, b, k) => sum + b * 2 ** (8 * k), 0);
  if (crc32(body) !== stated) throw new WalkDamaged("its checksum is not the one stated");
  if (body[0] !== WALK_VERSION) throw new WalkTooNew(body[0]);
  let at = 1;
  const varint = (): number => {
    let value = 0;
    for (let scale = 1; ; scale *= 128) {
      if (at >= body.length || scale > MOST) throw new WalkDamaged("a number in it has no end");
      const b = body[at++];
      value += (b & 127) * scale;
      if (b < 128) return value;
    }
  };
  const samples = varint();
  if (samples < 2 || samples * COLUMNS > body.length) throw new WalkDamaged(`it states ${samples} samples`);
  const rows = new Float64Array(COLUMNS * samples);
  for (let i = 0; i < rows.length; i++) {
    const coded = varint();
    rows[i] = (coded % 2 ? -(coded + 1) / 2 : coded / 2) + (i >= COLUMNS ? rows[i - COLUMNS] : 0);
    if (Math.abs(rows[i]) > MOST) throw new WalkDamaged("a number in it is out of range");
    if (i % COLUMNS === 0 && (i ? rows[i] <= rows[i - COLUMNS] : rows[i] !== 0)) throw new WalkDamaged("its times do not rise from 0");
    if (i % COLUMNS === 5 && Math.abs(rows[i]) > TURN / 4) throw new WalkDamaged("it looks beyond straight up or down");
  }
  if (at !== body.length) throw new WalkDamaged("it has more bytes than it states");
  if (rows[COLUMNS * (samples - 1)] > LONGEST_MS) throw new WalkDamaged(`it is longer than ${LONGEST_MS / 60_000} minutes`);
  return new Walk(rows);
}

/** CRC-32 (IEEE 802.3), not negative. */
export function crc32(bytes: ArrayLike<number>): number {
  let crc = -1;
  for (let i = 0; i < bytes.length; i++) {
    crc ^= bytes[i];
    for (let k = 0; k < 8; k++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
}
