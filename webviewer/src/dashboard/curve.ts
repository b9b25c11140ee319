/** Memory over budget: a staircase of what was found to suffice, and the same as a table. */
import { bytes, cost as costText, count } from "../ui/format";
import { h, s } from "./element";
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
  return part("cv-h", "Memory over budget", "found to suffice, as estimated before the bake; a job at that budget may need less", button,
    h("div", { class: "curve" }, plot(points, unit), h("div", { class: "scroll" }, table)));
}

/** The budget axis is logarithmic: half of the story lies within a quarter of the budget. */
function plot(points: CurvePoint[], unit: string): SVGSVGElement {
  const first = Math.log(points[0].budget);
  const span = Math.log(points[points.length - 1].budget) - first || 1;
  const x = (budget: number): number => LEFT + ((WIDTH - LEFT - RIGHT) * (Math.log(budget) - first)) / span;
  const y = (n: number): number => HEIGHT - BOTTOM - ((HEIGHT - TOP - BOTTOM) * n) / points[0].bytes;
  const path = points.map((p, k) => `${k ? `H${x(p.budget).toFixed(1)}V` : `M${x(p.budget).toFixed(1)} `}${y(p.bytes).toFixed(1)}`).join("");
  const levels = [1, 0.75, 0.5, 0.25, 0].map((share) => [
    s("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y(share * points[0].bytes), y2: y(share * points[0].bytes) }),
    s("text", { class: "end", x: LEFT - 8, y: y(share * points[0].bytes) + 4 }, bytes(Math.round(share * points[0].bytes)))]);
  let before = -Infinity;
  const labels = points.map((p, k) => {
    const at = x(p.budget);
    const last = k === points.length - 1;
    if (at - before < LEAST_APART || (!last && WIDTH - RIGHT - at < LEAST_APART)) return null;
    before = at;
    return s("text", { class: last ? "end" : k ? "mid" : "start", x: last ? WIDTH : at, y: HEIGHT - 8 }, costText(p.budget, unit));
  });
  const dots = points.map((p) => s("circle", { cx: x(p.budget), cy: y(p.bytes), r: 3 }, s("title", null, `${costText(p.budget, unit)}: ${bytes(p.bytes)}`)));
  const label = `Memory over budget: ${bytes(points[0].bytes)} at ${costText(points[0].budget, unit)}, falling to none at ${costText(points[points.length - 1].budget, unit)}`;
  return s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label }, ...levels.flat(), ...labels, s("path", { d: path }), ...dots);
}
