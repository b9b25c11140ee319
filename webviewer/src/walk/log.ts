/** What the frames of a replay were: columns that are filled in place, their sums, as CSV and as a plot. */
import type { CostUnit } from "../placementdb/manifest";
import { csv } from "../ui/csv";

export const WITHIN = 0;
export const STREAMING = 1; // over budget because something was not resident
export const HOPELESS = 2; // no impostors could have met the budget here, and the placement says so
export const UNPROMISED = 3; // impostors off, a held cell, or outside the view space: over, but nothing was promised
export const BROKEN = 4; // over budget with everything resident: the placement's promise is broken
export const REASONS = ["", "streaming", "hopeless", "not promised", "unexplained"];

/** One frame, filled anew for each: nothing is allocated while walking. */
export interface FrameFacts {
  calls: number;
  triangles: number;
  impostors: number;
  waiting: number; // impostors of the view that were not resident
  missing: number; // objects whose geometry was not resident
  cost: number;
  geometryCost: number;
  placementMs: number; // of the processor: finding the view, streaming, choosing, submitting impostors
  cell: number; // -1: none
  problemView: number; // -1: none
  reason: number;
}

export function reasonOf(over: boolean, promised: boolean, hopeless: boolean, waiting: boolean): number {
  if (!over) return WITHIN;
  if (!promised) return UNPROMISED;
  return waiting ? STREAMING : hopeless ? HOPELESS : BROKEN;
}

export class WalkLog {
  readonly frames: number;
  count = 0; // frames written so far
  readonly ms: Float64Array;
  readonly columns: Record<keyof FrameFacts, Float64Array>;

  constructor(frames: number) {
    this.frames = frames;
    this.ms = new Float64Array(frames).fill(NaN);
    const column = (): Float64Array => new Float64Array(frames);
    this.columns = {
      calls: column(), triangles: column(), impostors: column(), waiting: column(), missing: column(), cost: column(), geometryCost: column(), placementMs: column(),
      cell: column(), problemView: column(), reason: column(),
    };
  }

  add(f: FrameFacts): void {
    const { columns: c, count: k } = this;
    c.calls[k] = f.calls;
    c.triangles[k] = f.triangles;
    c.impostors[k] = f.impostors;
    c.waiting[k] = f.waiting;
    c.missing[k] = f.missing;
    c.cost[k] = f.cost;
    c.geometryCost[k] = f.geometryCost;
    c.placementMs[k] = f.placementMs;
    c.cell[k] = f.cell;
    c.problemView[k] = f.problemView;
    c.reason[k] = f.reason;
    this.count++;
  }

  over(reason: number): number {
    let n = 0;
    for (let k = 0; k < this.count; k++) if (this.columns.reason[k] === reason) n++;
    return n;
  }

  get overBudget(): number {
    return this.count - this.over(WITHIN);
  }

  /** Of the frame times: nearest rank; 0 without any. */
  percentileMs(share: number): number {
    const known = this.ms.subarray(0, this.count).filter(Number.isFinite).sort();
    return known.length ? known[Math.max(0, Math.ceil(share * known.length) - 1)] : 0;
  }
}

const CSV_HEADER = [
  "frame", "walk_ms", "time_ms", "calls", "triangles", "impostors", "impostors_waiting", "objects_missing", "cost", "geometry_cost", "cell", "problem_view", "over_budget", "placement_ms",
];

/** One line a frame. */
export function walkCsv(log: WalkLog, stepMs: number): string {
  const { columns: c } = log;
  const id = (n: number): number | null => (n < 0 ? null : n);
  const rows = Array.from({ length: log.count }, (_, k) => [
    k, (k * stepMs).toFixed(3), Number.isFinite(log.ms[k]) ? log.ms[k].toFixed(3) : null, c.calls[k], c.triangles[k], c.impostors[k], c.waiting[k], c.missing[k], c.cost[k],
    c.geometryCost[k], id(c.cell[k]), id(c.problemView[k]), REASONS[c.reason[k]], c.placementMs[k].toFixed(3),
  ]);
  return csv(CSV_HEADER, rows);
}

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [960, 340, 64, 880, 40, 300];
const INK = "#161b19";

/** The walk as an SVG picture: cost of each frame with and without impostors, frame times, the budget, and what went over. */
export function walkPlot(log: WalkLog, stepMs: number, title: string, budget: { unit: CostUnit; amount: number }): string {
  const { cost, geometryCost, reason } = log.columns;
  const n = log.count;
  const time = budget.unit === "ns";
  const scale = time ? 1e6 : 1;
  let top = budget.amount;
  for (let k = 0; k < n; k++) top = Math.max(top, cost[k], geometryCost[k], time && log.ms[k] > 0 ? log.ms[k] * scale : 0);
  top = Math.min(1.05 * top, 6 * budget.amount) || 1;
  const x = (k: number): string => (LEFT + ((RIGHT - LEFT) * k) / Math.max(1, n - 1)).toFixed(1);
  const y = (v: number): string => (BOTTOM - (BOTTOM - TOP) * Math.min(1, v / top)).toFixed(1);
  const path = (of: (k: number) => number): string => {
    let d = "";
    let gap = true;
    for (let k = 0; k < n; k++) {
      const v = of(k);
      if (Number.isFinite(v)) d += `${gap ? "M" : "L"}${x(k)} ${y(v)}`;
      gap = !Number.isFinite(v);
    }
    return d;
  };
  let over = "";
  for (let k = 0; k < n; k++) if (reason[k] !== WITHIN) over += `M${x(k)} ${TOP - 10}v8`;
  const line = (d: string, color: string, rest: string): string => `<path d="${d}" fill="none" stroke="${color}" ${rest}/>`;
  const label = (at: string, px: number, color: string, words: string, anchor = "start"): string =>
    `<text x="${px}" y="${at}" fill="${color}" text-anchor="${anchor}">${words}</text>`;
  const seconds = ((n * stepMs) / 1000).toFixed(1);
  const named = (v: number): string => (time ? (v / scale).toFixed(1) : Math.round(v).toLocaleString("en"));
  const last = Math.max(0, n - 1);
  const legends = spread([
    { y: Number(y(budget.amount)), color: "#935200", words: `budget ${named(budget.amount)}` },
    { y: n ? Number(y(cost[last])) : BOTTOM, color: "#00606d", words: "impostors" },
    { y: n ? Number(y(geometryCost[last])) : BOTTOM, color: "#5d6662", words: "geometry" },
  ]);
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${WIDTH} ${HEIGHT}" width="${WIDTH}" height="${HEIGHT}" font-family="sans-serif" font-size="12" role="img">`,
    `<title>${escaped(title)}</title><rect width="${WIDTH}" height="${HEIGHT}" fill="#fff"/>`,
    `<text x="${LEFT}" y="20" fill="${INK}" font-weight="600">${escaped(title)}</text>`,
    line(`M${LEFT} ${TOP}V${BOTTOM}H${RIGHT}`, "#858e89", 'stroke-width="1"'),
    line(path((k) => geometryCost[k]), "#5d6662", 'stroke-width="1"'),
    time ? line(path((k) => log.ms[k] * scale), "#d29c4d", 'stroke-width="1" stroke-dasharray="2 2"') : "",
    line(path((k) => cost[k]), "#00606d", 'stroke-width="1.8"'),
    line(`M${LEFT} ${y(budget.amount)}H${RIGHT}`, "#935200", 'stroke-width="1.2"'),
    over ? line(over, "#935200", 'stroke-width="1.5"') : "",
    label(String(TOP + 4), LEFT - 6, INK, named(top), "end"),
    label(String(BOTTOM + 4), LEFT - 6, INK, "0", "end"),
    ...legends.map((l) => label(String(l.y + 4), RIGHT + 6, l.color, l.words)),
    label(String(BOTTOM + 20), LEFT, INK, "0 s"),
    label(String(BOTTOM + 20), RIGHT, INK, `${seconds} s`, "end"),
    label(String(BOTTOM + 20), (LEFT + RIGHT) / 2, INK, `${time ? "predicted ms (measured: dotted)" : budget.unit} a frame; ticks: over budget`, "middle"),
    "</svg>",
  ].join("");
}

/** Labels at least 14 apart, in the order of their places. */
function spread<T extends { y: number }>(labels: T[]): T[] {
  const sorted = [...labels].sort((a, b) => a.y - b.y);
  sorted.forEach((l, k) => {
    if (k) l.y = Math.max(l.y, sorted[k - 1].y + 14);
  });
  return sorted;
}

function escaped(words: string): string {
  return words.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}
