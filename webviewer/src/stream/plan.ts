/** Which chunks and pages to have, best first. Pure. */
import type { PlacementChunk } from "../placementdb/chunk";
import type { Box, Manifest } from "../placementdb/manifest";
import { impostorsOfView } from "../placementdb/placement";
import { intervalDirection } from "../select/intervals";
import { PREFETCH_SHARE } from "./level_plan";

export interface Plan {
  chunks: number[]; // best first
  pages: number[]; // best first, at most `slots`
}

/** Seconds ahead that the camera's motion is followed: what the next cell needs takes some files' time to come. */
export function lookAheadS(fileS: number): number {
  return Math.min(8, 0.5 + 4 * fileS);
}

/**
 * The pages of what is shown now and what is likely next (`nearby`, best first), then the rest of this cell's chunk, then
 * chunks by the distance of their box from where the camera will be. `current` is -1 where the cell is in no chunk.
 */
export function plan(manifest: Manifest, current: number, nearby: Iterable<number>, ahead: ArrayLike<number>, slots: number, chunkBytesCap: number): Plan {
  const order = manifest.chunks
    .map((entry, k) => ({ k, gap: k === current ? -1 : gapTo(entry.box, ahead) }))
    .sort((a, b) => a.gap - b.gap || a.k - b.k);
  const chunks: number[] = [];
  let bytes = 0;
  for (const { k } of order) {
    bytes += manifest.chunks[k].expanded ?? manifest.chunks[k].bytes;
    if (chunks.length && bytes > chunkBytesCap) break;
    chunks.push(k);
  }
  const pages = new Set<number>();
  for (const p of nearby) if (pages.size < slots) pages.add(p);
  // Prefetching leaves some slots to what was shown before, so that turning back fetches nothing again; unless all fit.
  const prefetched = slots < manifest.pages.length ? Math.floor(PREFETCH_SHARE * slots) : slots;
  for (const k of chunks) for (const p of manifest.chunks[k].pages) if (pages.size < prefetched) pages.add(p);
  return { chunks, pages: [...pages] };
}

function gapTo([low, high]: Box, p: ArrayLike<number>): number {
  let sum = 0;
  for (let a = 0; a < 3; a++) sum += Math.max(low[a] - p[a], p[a] - high[a], 0) ** 2;
  return Math.sqrt(sum);
}

/** The distinct pages of each local impostor of a chunk, found once. */
export class ChunkPages {
  private readonly row: Int32Array;
  private readonly page: Int32Array;
  private readonly listPages: (readonly number[] | undefined)[] = [];
  private readonly chunk: PlacementChunk;

  constructor(chunk: PlacementChunk) {
    this.chunk = chunk;
    const n = chunk.impostorId.length;
    const pages: number[] = [];
    this.row = new Int32Array(n + 1);
    for (let m = 0; m < n; m++) {
      const distinct = new Set(chunk.layerPage.subarray(chunk.impostorLayer[m], chunk.impostorLayer[m + 1]));
      pages.push(...distinct);
      this.row[m + 1] = pages.length;
    }
    this.page = Int32Array.from(pages);
  }

  of(impostor: number): Int32Array {
    return this.page.subarray(this.row[impostor], this.row[impostor + 1]);
  }

  /** Adds the pages of a local problem view to `out`. */
  addView(view: number, out: Set<number>): void {
    for (const p of this.ofList(view)) out.add(p);
  }

  /** The distinct pages of a view's list of impostors, found once: views that are planned for come again and again. */
  private ofList(view: number): readonly number[] {
    const list = this.chunk.viewList[view];
    let pages = this.listPages[list];
    if (!pages) {
      const distinct = new Set<number>();
      for (const m of impostorsOfView(this.chunk, view)) for (const p of this.of(m)) distinct.add(p);
      this.listPages[list] = pages = [...distinct];
    }
    return pages;
  }

  /** Adds the pages of a cell's problem views, those nearest to the direction first: what turning on the spot needs. */
  addCell(cell: number, direction: ArrayLike<number>, edges: ArrayLike<number>, out: Set<number>): void {
    const c = cell - this.chunk.cells[0];
    const first = this.chunk.cellView[c];
    const length = Math.hypot(direction[0], direction[1], direction[2]);
    const views = Array.from({ length: this.chunk.cellView[c + 1] - first }, (_, k) => {
      const d = intervalDirection(edges, this.chunk.viewInterval[first + k]);
      return { view: first + k, cosine: (d[0] * direction[0] + d[1] * direction[1] + d[2] * direction[2]) / length };
    });
    views.sort((a, b) => b.cosine - a.cosine || a.view - b.view);
    for (const { view } of views) this.addView(view, out);
  }
}
