/** Memory over budget: a staircase of what was found to suffice, and the same as a table. */
import { bytes, cost as costText, count } from "../ui/format";
import { h, s, scroller } from "./element";
import { csvButton, part } from "./report_parts";
import type { CurvePoint, Report } from "./report_types";

const WIDTH = 640;
const HEIGHT = 200;
const LEFT = 84;
const RIGHT = 20;
const TOP = 12;
const BOTTOM = 28;
const LEAST_APART = 104; // between labels of the budget axis

export function curvePanel(report: Report): HTMLElement | null {
  const points = report.curve ?? [];
  if (points.length < 2 || points[0].budget <= 0 || !points[0].bytes) return null;
  const unit = report.unit ?? "";
  const over = points.some((p) => p.views_over > 0);
  const rows = points.map((p) => h("tr", null, h("th", { scope: "row", class: "nw" }, costText(p.budget, unit)), h("td", { class: "r nw" }, bytes(p.bytes)),
    h("td", { class: "r nw" }, `${Math.round((100 * p.bytes) / points[0].bytes)} %`), over ? h("td", { class: "r nw" }, count(p.views_over)) : null));
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Memory that suffices for each budget"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Budget"), h("th", { scope: "col", class: "r" }, "Memory"), h("th", { scope: "col", class: "r" }, "Of this"), over ? h("th", { scope: "col", class: "r" }, "Views over it") : null)), h("tbody", null, ...rows));
  const button = csvButton("memory-over-budget", [`budget_${unit}`, "bytes", "views_over"], () => points.map((p) => [p.budget, p.bytes, p.views_over]));
  const label = `Memory over budget: ${bytes(points[0].bytes)} at ${costText(points[0].budget, unit)}, falling to none at ${costText(points[points.length - 1].budget, unit)}`;
  return part("cv-h", "Memory over budget", "found to suffice, as estimated before the bake; a job at that budget may need less", button,
    h("div", { class: "curve" }, curvePlot([{ name: "", kind: "one", points }], unit, label), scroller(table)));
}

/** The staircase of one placement; `kind` is its class, its shape on paper a dash. */
export interface Series {
  name: string;
  kind: string;
  points: readonly CurvePoint[];
}

/** The budget axis is logarithmic: half of the story lies within a quarter of the budget. */
export function curvePlot(series: readonly Series[], unit: string, label: string): SVGSVGElement {
  const all = series.flatMap((one) => one.points);
  const budgets = [...new Set(all.map((p) => p.budget))].sort((a, b) => a - b);
  const most = Math.max(1, ...all.map((p) => p.bytes));
  const first = Math.log(budgets[0]);
  const span = Math.log(budgets[budgets.length - 1]) - first || 1;
  const x = (budget: number): number => LEFT + ((WIDTH - LEFT - RIGHT) * (Math.log(budget) - first)) / span;
  const y = (n: number): number => HEIGHT - BOTTOM - ((HEIGHT - TOP - BOTTOM) * n) / most;
  const levels = [1, 0.75, 0.5, 0.25, 0].map((share) => [
    s("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y(share * most), y2: y(share * most) }),
    s("text", { class: "end", x: LEFT - 8, y: y(share * most) + 4 }, bytes(Math.round(share * most)))]);
  let before = -Infinity;
  const labels = budgets.map((budget, k) => {
    const at = x(budget);
    const last = k === budgets.length - 1;
    if (at - before < LEAST_APART || (!last && WIDTH - RIGHT - at < LEAST_APART)) return null;
    before = at;
    return s("text", { class: last ? "end" : k ? "mid" : "start", x: last ? WIDTH : at, y: HEIGHT - 8 }, costText(budget, unit));
  });
  const lines = series.flatMap(({ name, kind, points }) => {
    const d = points.map((p, k) => `${k ? `H${x(p.budget).toFixed(1)}V` : `M${x(p.budget).toFixed(1)} `}${y(p.bytes).toFixed(1)}`).join("");
    return [s("path", { class: kind, d }), ...points.map((p) => s("circle", { class: kind, cx: x(p.budget), cy: y(p.bytes), r: 3 }, s("title", null, `${name ? `${name}, ` : ""}${costText(p.budget, unit)}: ${bytes(p.bytes)}`)))];
  });
  return s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label }, ...levels.flat(), ...labels, ...lines);
}
