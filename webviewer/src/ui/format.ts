/** Numbers as people read them. Shared by all pages. */

const grouped = new Intl.NumberFormat("en");

export function count(n: number): string {
  return grouped.format(Math.round(n));
}

/** 1,840,000 -> "1.84 M" */
export function short(n: number): string {
  if (n >= 1e6) return `${(n / 1e6).toFixed(n < 1e7 ? 2 : 1)} M`;
  return count(n);
}

export function bytes(n: number): string {
  if (n >= 1e9) return `${(n / 1e9).toFixed(2)} GB`;
  if (n >= 1e6) return `${(n / 1e6).toFixed(1)} MB`;
  if (n >= 1e3) return `${(n / 1e3).toFixed(1)} kB`;
  return `${n} B`;
}

/** A cost in the budget's unit: "13.4 ms", "1,180 calls". */
export function cost(n: number, unit: string): string {
  return unit === "ns" ? `${(n / 1e6).toFixed(1)} ms` : `${count(n)} ${unit}`;
}

/** A tick of an axis, at most five characters: "1,300", "100k", "1.8M". */
export function tick(n: number): string {
  if (n >= 1e6) return `${(n / 1e6).toFixed(n < 1e7 ? 1 : 0)}M`;
  if (n >= 1e4) return `${Math.round(n / 1e3)}k`;
  return n < 10 && n % 1 ? n.toFixed(1) : count(n);
}

/** Compass direction of a vector in the ground plane, degrees: 0 is -z (north on the map), 90 is +x. */
export function bearing(direction: ArrayLike<number>): number {
  const degrees = (Math.atan2(direction[0], -direction[2]) * 180) / Math.PI;
  return (Math.round(degrees) + 360) % 360;
}
