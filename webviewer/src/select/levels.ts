/**
 * At which level of detail objects are drawn: chosen per cell, by the distance between object and cell, so that what is
 * drawn is what was counted. The twin of `Placement.levels_in` (services/farfield/placementdb/read.py), in float64.
 */
import type { PlacementIndex } from "../placementdb/index_file";

/** Writes the level of every object into `out`: 0 the object itself; a cell of -1 is nowhere, and 0 for all. */
export function setLevels(index: PlacementIndex, cell: number, out: Uint8Array): void {
  out.fill(0);
  const { levelRow, levelFrom, objectBox, nodeBox } = index;
  if (!levelRow.length || cell < 0) return;
  const node = 6 * index.cellNode[cell];
  for (let o = 0; o < out.length; o++) {
    if (levelRow[o] === levelRow[o + 1]) continue;
    let gap2 = 0;
    for (let a = 0; a < 3; a++) {
      const d = Math.max(objectBox[6 * o + a] - nodeBox[node + 3 + a], nodeBox[node + a] - objectBox[6 * o + 3 + a], 0);
      gap2 += d * d;
    }
    const distance = Math.sqrt(gap2);
    for (let k = levelRow[o]; k < levelRow[o + 1]; k++) if (levelFrom[k] <= distance) out[o] = k - levelRow[o] + 1;
  }
}

/** What an object costs at a level, without its pixels. */
export function costAt(index: PlacementIndex, o: number, level: number): number {
  return level ? index.levelCost[index.levelRow[o] + level - 1] : index.objectCost[o];
}

export function trianglesAt(index: PlacementIndex, o: number, level: number): number {
  return level ? index.levelTriangles[index.levelRow[o] + level - 1] : index.objectTriangles[o];
}
