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
