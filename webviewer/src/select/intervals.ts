/** Direction -> interval id: `find_interval` of services/farfield/geometry/intervals.py with the manifest's edges. */

/** Interval of a direction of any length but 0; -1 for 0 or anything not finite. */
export function findInterval(edges: ArrayLike<number>, direction: ArrayLike<number>): number {
  const n = edges.length - 1;
  let m = 0;
  for (let a = 0; a < 3; a++) {
    if (!Number.isFinite(direction[a])) return -1;
    if (Math.abs(direction[a]) > Math.abs(direction[m])) m = a;
  }
  const length = Math.abs(direction[m]);
  if (length === 0) return -1;
  const face = 2 * m + (direction[m] < 0 ? 1 : 0);
  const i = innerEdgesUpTo(edges, direction[(m + 1) % 3] / length);
  const j = innerEdgesUpTo(edges, direction[(m + 2) % 3] / length);
  return (face * n + j) * n + i;
}

function innerEdgesUpTo(edges: ArrayLike<number>, ratio: number): number {
  let count = 0;
  while (count + 1 < edges.length - 1 && edges[count + 1] <= ratio) count++;
  return count;
}

/** Face, i and j of an interval id; n intervals along the side of a face. */
export function splitInterval(interval: number, n: number): { face: number; i: number; j: number } {
  return { face: Math.floor(interval / (n * n)), i: interval % n, j: Math.floor(interval / n) % n };
}

const FACES = ["+X", "-X", "+Y", "-Y", "+Z", "-Z"];

export function intervalName(interval: number, n: number): string {
  const { face, i, j } = splitInterval(interval, n);
  return `${FACES[face]} ${i},${j}`;
}

/** Unit direction in the middle (of the ratios) of an interval. */
export function intervalDirection(edges: ArrayLike<number>, interval: number): [number, number, number] {
  const n = edges.length - 1;
  const { face, i, j } = splitInterval(interval, n);
  const m = face >> 1;
  const d: [number, number, number] = [0, 0, 0];
  d[m] = face % 2 ? -1 : 1;
  d[(m + 1) % 3] = (edges[i] + edges[i + 1]) / 2;
  d[(m + 2) % 3] = (edges[j] + edges[j + 1]) / 2;
  const length = Math.hypot(d[0], d[1], d[2]);
  return [d[0] / length, d[1] / length, d[2] / length];
}
