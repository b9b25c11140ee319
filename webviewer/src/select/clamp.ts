/** The camera stays in the view space: the nearest point of its boxes. */
import type { Box, Vec3 } from "../placementdb/manifest";

/** Writes the point of the boxes nearest to `p` into `out` (may be `p`) and returns the box it lies in. */
export function clampToBoxes(boxes: readonly Box[], p: Vec3, out: Vec3): number {
  let best = 0;
  let least = Infinity;
  for (let b = 0; b < boxes.length; b++) {
    const [low, high] = boxes[b];
    let distance = 0;
    for (let a = 0; a < 3; a++) {
      const gap = Math.max(low[a] - p[a], p[a] - high[a], 0);
      distance += gap * gap;
    }
    if (distance < least) {
      least = distance;
      best = b;
    }
  }
  const [low, high] = boxes[best];
  for (let a = 0; a < 3; a++) out[a] = Math.min(Math.max(p[a], low[a]), high[a]);
  return best;
}

/** Is the point in some box (closed)? */
export function insideBoxes(boxes: readonly Box[], p: ArrayLike<number>): boolean {
  return boxes.some(([low, high]) => [0, 1, 2].every((a) => low[a] <= p[a] && p[a] <= high[a]));
}
