/** Position -> leaf cell: `find_cell` of services/farfield/geometry/cells.py, steps 1 to 3 of the format's section 6. */
import type { PlacementIndex } from "../placementdb/index_file";
import type { Manifest } from "../placementdb/manifest";

type CellTree = Pick<PlacementIndex, "nodeAxis" | "nodePlane" | "nodeLow" | "nodeHigh" | "nodeStart" | "viewBox">;

/** Leaf cell of a position in scene metres, -1 outside the view space. float64, half-open rules. */
export function findCell(tree: CellTree, manifest: Pick<Manifest, "origin_m" | "view_space">, position: ArrayLike<number>): number {
  const q = [0, 0, 0];
  for (let a = 0; a < 3; a++) q[a] = position[a] - manifest.origin_m[a];
  const boxes = tree.viewBox;
  const n = boxes.length / 6;
  let first = firstHolding(boxes, n, q);
  if (first < 0) {
    // The origin is not always subtracted exactly: a position on the boundary of a public box still counts.
    first = manifest.view_space.findIndex(([low, high]) => [0, 1, 2].every((a) => low[a] <= position[a] && position[a] <= high[a]));
    if (first < 0) return -1;
    for (let a = 0; a < 3; a++) q[a] = Math.min(Math.max(q[a], boxes[6 * first + a]), boxes[6 * first + 3 + a]);
    first = firstHolding(boxes, n, q);
  }
  const below = [false, false, false];
  if (!someHalfOpen(boxes, n, q)) {
    for (let a = 0; a < 3; a++) {
      const low = boxes[6 * first + a];
      const high = boxes[6 * first + 3 + a];
      below[a] = q[a] === high && low < high;
    }
  }
  let node = 0;
  while (tree.nodeAxis[node] >= 0) {
    const axis = tree.nodeAxis[node];
    const plane = tree.nodePlane[node];
    const goHigh = below[axis] ? q[axis] > plane : q[axis] >= plane;
    node = goHigh ? tree.nodeHigh[node] : tree.nodeLow[node];
  }
  return tree.nodeStart[node];
}

function firstHolding(boxes: Float64Array, n: number, q: number[]): number {
  for (let b = 0; b < n; b++) {
    let inside = true;
    for (let a = 0; a < 3; a++) inside &&= boxes[6 * b + a] <= q[a] && q[a] <= boxes[6 * b + 3 + a];
    if (inside) return b;
  }
  return -1;
}

function someHalfOpen(boxes: Float64Array, n: number, q: number[]): boolean {
  for (let b = 0; b < n; b++) {
    let inside = true;
    for (let a = 0; a < 3; a++) {
      const low = boxes[6 * b + a];
      const high = boxes[6 * b + 3 + a];
      inside &&= low <= q[a] && (q[a] < high || (low === high && q[a] === high));
    }
    if (inside) return true;
  }
  return false;
}
