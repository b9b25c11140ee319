/** How fast one may go before what the next cell needs cannot have come. Pure. */
import type { PlacementChunk } from "../placementdb/chunk";
import type { PlacementIndex } from "../placementdb/index_file";
import type { Manifest } from "../placementdb/manifest";
import { visibleOfCell } from "../placementdb/placement";
import { setLevels } from "../select/levels";
import type { LevelPlan } from "./level_plan";
import type { ChunkPages } from "./plan";

/** The most bytes a metre, over pairs of neighbouring cells of a chunk: what the one needs and the other did not. */
export function bytesPerMetre(manifest: Manifest, index: PlacementIndex, chunk: PlacementChunk, pages: ChunkPages, level: LevelPlan | null): number {
  const [first, stop] = chunk.cells;
  const levels = new Uint8Array(manifest.counts.objects);
  const needs: { pages: Set<number>; parts: Set<number> }[] = [];
  for (let cell = first; cell < stop; cell++) {
    const of = { pages: new Set<number>(), parts: new Set<number>() };
    for (let v = chunk.cellView[cell - first]; v < chunk.cellView[cell - first + 1]; v++) pages.addView(v, of.pages);
    setLevels(index, cell, levels);
    level?.addParts(visibleOfCell(chunk, cell) ?? levels.keys(), levels, of.parts);
    needs.push(of);
  }
  const geometry = manifest.geometry;
  const partBytes = [...(geometry?.pages ?? []), ...(geometry?.textures ?? [])];
  let most = 0;
  for (let a = 0; a < needs.length; a++) {
    for (let b = 0; b < needs.length; b++) {
      const metres = a === b ? 0 : neighbours(index, first + a, first + b);
      if (!metres) continue;
      let bytes = 0;
      for (const p of needs[b].pages) if (!needs[a].pages.has(p)) bytes += manifest.pages[p].bytes;
      for (const p of needs[b].parts) if (!needs[a].parts.has(p)) bytes += partBytes[p].bytes;
      most = Math.max(most, bytes / metres);
    }
  }
  return most;
}

/** Distance of the middles of two cells whose boxes touch, 0 where they do not. */
function neighbours(index: PlacementIndex, a: number, b: number): number {
  const p = 6 * index.cellNode[a];
  const q = 6 * index.cellNode[b];
  let sum = 0;
  for (let k = 0; k < 3; k++) {
    const [l, h, m, i] = [index.nodeBox[p + k], index.nodeBox[p + 3 + k], index.nodeBox[q + k], index.nodeBox[q + 3 + k]];
    if (m > h || l > i) return 0;
    sum += ((l + h - m - i) / 2) ** 2;
  }
  return Math.sqrt(sum);
}
