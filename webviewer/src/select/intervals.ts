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
