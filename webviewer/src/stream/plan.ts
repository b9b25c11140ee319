/** Which chunks and pages to have, best first. Pure. */
import type { PlacementChunk } from "../placementdb/chunk";
import type { Box, Manifest } from "../placementdb/manifest";

export interface Plan {
  chunks: number[]; // best first
  pages: number[]; // best first, at most `slots`
}

/** Seconds ahead that the camera's motion is followed. */
export const LOOK_AHEAD_S = 1.5;

/**
 * The pages of what is shown now, then the rest of this cell's chunk, then chunks by the distance of their box from where
 * the camera will be. `needed` are page ids, may repeat; `current` is -1 where the cell is in no chunk.
 */
export function plan(manifest: Manifest, current: number, needed: Iterable<number>, ahead: ArrayLike<number>, slots: number, chunkBytesCap: number): Plan {
  const order = manifest.chunks
    .map((entry, k) => ({ k, gap: k === current ? -1 : gapTo(entry.box, ahead) }))
    .sort((a, b) => a.gap - b.gap || a.k - b.k);
  const chunks: number[] = [];
  let bytes = 0;
  for (const { k } of order) {
    bytes += manifest.chunks[k].bytes;
    if (chunks.length && bytes > chunkBytesCap) break;
    chunks.push(k);
  }
  const pages = new Set<number>();
  for (const p of needed) if (pages.size < slots) pages.add(p);
  for (const k of chunks) for (const p of manifest.chunks[k].pages) if (pages.size < slots) pages.add(p);
  return { chunks, pages: [...pages] };
}

function gapTo([low, high]: Box, p: ArrayLike<number>): number {
  let sum = 0;
  for (let a = 0; a < 3; a++) sum += Math.max(low[a] - p[a], p[a] - high[a], 0) ** 2;
  return Math.sqrt(sum);
}

/** Page ids that the local impostors of a chunk use, with repeats. */
export function pagesOf(chunk: PlacementChunk, impostors: ArrayLike<number>): number[] {
  const out: number[] = [];
  for (let i = 0; i < impostors.length; i++) {
    for (let r = chunk.impostorLayer[impostors[i]]; r < chunk.impostorLayer[impostors[i] + 1]; r++) out.push(chunk.layerPage[r]);
  }
  return out;
}
