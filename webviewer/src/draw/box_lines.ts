const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7];

/** Line ends (three numbers each, 24 ends a box) of n boxes, relative to `anchor`. */
export function boxLines(boxes: Float64Array, anchor: ArrayLike<number>): Float32Array {
  const n = boxes.length / 6;
  const out = new Float32Array(72 * n);
  for (let b = 0; b < n; b++) {
    EDGES.forEach((corner, k) => {
      for (let a = 0; a < 3; a++) out[72 * b + 3 * k + a] = boxes[6 * b + (corner & (1 << a) ? 3 : 0) + a] - anchor[a];
    });
  }
  return out;
}
