/**
 * Which parts of the level (pages of geometry, texture files) to have, best first. Pure.
 *
 * A part is as urgent as the most urgent object that needs it: first what the view draws as geometry, nearest first; then what
 * else the cell sees; then the rest, where memory allows.
 */
import type { GeometryIndex } from "../placementdb/geometry";
import type { GeometryEntry } from "../placementdb/manifest";

/** Prefetching stops here; the rest of the memory keeps what was left, so that turning back fetches nothing again. */
export const PREFETCH_SHARE = 0.8;
const CLASS_M = 1e9; // metres that a class lies behind the one before

export interface PartsWanted {
  parts: number[]; // best first
  urgent: number; // the first so many are in view
  near: number; // the first so many are of objects that the cell sees
}

export class LevelPlan {
  private readonly score: Float64Array;
  private readonly textureRow: Int32Array; // parts of the textures of mesh m: [row[m], row[m+1])
  private readonly texturePart: Int32Array;
  private readonly seen: Uint8Array;

  constructor(private readonly index: GeometryIndex, entry: GeometryEntry, private readonly objectBox: Float64Array) {
    const pages = entry.pages.length;
    this.score = new Float64Array(pages + entry.textures.length);
    this.seen = new Uint8Array(index.objectMesh.length);
    const meshes = index.meshPrimitive.length - 1;
    const parts: number[] = [];
    this.textureRow = new Int32Array(meshes + 1);
    for (let m = 0; m < meshes; m++) {
      const files = new Set<number>();
      for (let p = index.meshPrimitive[m]; p < index.meshPrimitive[m + 1]; p++) {
        const k = index.primitiveMaterial[p];
        for (const x of [index.texture[k], index.glow[k]]) if (x >= 0) files.add(pages + index.textureFile[x]);
      }
      parts.push(...files);
      this.textureRow[m + 1] = parts.length;
    }
    this.texturePart = Int32Array.from(parts);
  }

  /**
   * `inView` (its first n) are drawn or on their way, `covered` (by object) are those that impostors will show, `visible` what
   * the cell sees (null: all); `levels` by object; `ahead` is relative to origin_m.
   */
  wanted(
    inView: Int32Array, n: number, covered: Uint8Array, visible: Int32Array | null, levels: Uint8Array, ahead: ArrayLike<number>,
    partBytes: Float64Array, capBytes: number,
  ): PartsWanted {
    const { score, seen } = this;
    score.fill(Infinity);
    seen.fill(visible ? 2 : 1);
    if (visible) for (let k = 0; k < visible.length; k++) seen[visible[k]] = 1;
    for (let k = 0; k < n; k++) if (!covered[inView[k]]) seen[inView[k]] = 0;
    for (let o = 0; o < seen.length; o++) this.need(o, levels[o], seen[o] * CLASS_M + this.distance(o, ahead));
    const order = Array.from(score.keys()).filter((p) => score[p] < Infinity).sort((a, b) => score[a] - score[b] || a - b);
    const out: PartsWanted = { parts: [], urgent: 0, near: 0 };
    let bytes = 0;
    for (const part of order) {
      bytes += partBytes[part];
      const urgent = score[part] < CLASS_M;
      if (bytes > (urgent ? 1 : PREFETCH_SHARE) * capBytes && out.parts.length) break;
      out.parts.push(part);
      if (urgent) out.urgent++;
      if (score[part] < 2 * CLASS_M) out.near++;
    }
    return out;
  }

  /** Adds the parts that objects need to `out`. */
  addParts(objects: Iterable<number>, levels: Uint8Array, out: Set<number>): void {
    const { index } = this;
    for (const o of objects) {
      const mesh = index.objectMesh[o];
      out.add(index.modelPage[index.meshModel[mesh] + levels[o]]);
      for (let k = this.textureRow[mesh]; k < this.textureRow[mesh + 1]; k++) out.add(this.texturePart[k]);
    }
  }

  private need(o: number, level: number, score: number): void {
    const { index } = this;
    const mesh = index.objectMesh[o];
    const page = index.modelPage[index.meshModel[mesh] + level];
    if (score < this.score[page]) this.score[page] = score;
    for (let k = this.textureRow[mesh]; k < this.textureRow[mesh + 1]; k++) {
      const part = this.texturePart[k];
      if (score < this.score[part]) this.score[part] = score;
    }
  }

  private distance(o: number, p: ArrayLike<number>): number {
    let sum = 0;
    for (let a = 0; a < 3; a++) {
      const gap = Math.max(this.objectBox[6 * o + a] - p[a], p[a] - this.objectBox[6 * o + 3 + a], 0);
      sum += gap * gap;
    }
    return Math.sqrt(sum);
  }
}
