/** What differs between two jobs: settings by their dotted names, figures of their reports. */
import type { Settings } from "../api/schema";
import { bytes, cost as costText, count } from "../ui/format";
import { duration } from "./format";
import type { Report } from "./report_types";

export interface Difference {
  key: string;
  a: string;
  b: string;
}

const ABSENT = "—";

function flat(value: unknown, key: string, into: Map<string, string>): Map<string, string> {
  if (value && typeof value === "object" && !Array.isArray(value)) {
    for (const [name, inner] of Object.entries(value)) flat(inner, key ? `${key}.${name}` : name, into);
  } else into.set(key, value === null || value === undefined ? ABSENT : typeof value === "object" ? JSON.stringify(value) : String(value));
  return into;
}

/** Settings that differ, by name; one that only one of the two states counts as absent in the other. */
export function differences(a: Settings, b: Settings): Difference[] {
  const [left, right] = [flat(a, "", new Map()), flat(b, "", new Map())];
  return [...new Set([...left.keys(), ...right.keys()])].sort()
    .map((key) => ({ key, a: left.get(key) ?? ABSENT, b: right.get(key) ?? ABSENT })).filter((d) => d.a !== d.b);
}

export interface Figure {
  name: string;
  a: number | null;
  b: number | null;
  text: (n: number) => string;
  /** Less is better: the lesser of the two is marked; null: neither is better. */
  less: boolean | null;
}

/** Figures that at least one of the two reports has. */
export function figuresOf(a: Report, b: Report): Figure[] {
  const one = (name: string, of: (r: Report) => number | null | undefined, text: (n: number) => string, less: boolean | null): Figure =>
    ({ name, a: of(a) ?? null, b: of(b) ?? null, text, less });
  const percent = (n: number): string => `${(100 * n).toFixed(1)} %`;
  const rows = [
    one("Impostor memory", (r) => r.bytes, bytes, true),
    one("Proven lower bound", (r) => r.lower_bound_bytes, bytes, null),
    one("Files", (r) => r.file_bytes, bytes, true),
    one("Video memory, all pages", (r) => r.video_bytes, bytes, true),
    one("Impostors", (r) => r.impostors, count, null),
    one("Layers", (r) => r.layers, count, null),
    one("Candidates", (r) => r.candidates, count, null),
    one("View-space cells", (r) => r.cells, count, null),
    one("Problem views", (r) => r.problem_views, count, true),
    one("Hopeless views", (r) => r.hopeless_views, count, true),
    one("Worst verified view", (r) => r.verified?.worst_ratio, percent, true),
    one("Verified views over budget", (r) => r.verified?.over_budget, count, true),
    one("Pairs of pictures that failed", (r) => r.proof?.failed, count, true),
    one("FLIP", (r) => (r.proof?.pairs ? r.proof.flip : null), (n) => n.toFixed(3), true),
    one("Time", (r) => r.seconds, duration, true),
    one("Peak memory", (r) => r.peak_bytes, bytes, true),
  ];
  if (a.unit === b.unit) rows.splice(10, 0, one("Worst view, bound as placed", (r) => r.worst_cost_bound, (n) => costText(n, a.unit ?? ""), true));
  return rows.filter((row) => row.a !== null || row.b !== null);
}

/** "−12 %": how the second differs from the first; "" where that says nothing. */
export function change({ a, b }: Figure): string {
  if (a === null || b === null || a === b) return "";
  if (a === 0) return "new";
  const percent = (100 * (b - a)) / Math.abs(a);
  const size = Math.abs(percent);
  return `${percent < 0 ? "−" : "+"}${size >= 10 ? size.toFixed(0) : size.toFixed(1)} %`;
}
