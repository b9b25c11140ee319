/** Problem views by what they cost over the budget, as geometry and as placed: what the impostors did, in one picture. */
import { count } from "../ui/format";
import { BREAKS, classOf } from "./cell_classes";
import { h, s, scroller } from "./element";
import { csvButton, part } from "./report_parts";

/** Views in each class of cost over budget, cell_classes.ts. */
export interface Histogram {
  asGeometry: number[];
  asPlaced: number[];
}

export function emptyHistogram(): Histogram {
  const zeros = (): number[] => Array.from({ length: BREAKS.length + 1 }, () => 0);
  return { asGeometry: zeros(), asPlaced: zeros() };
}

export function addView(into: Histogram, geometry: number, placed: number, budget: number): void {
  into.asGeometry[classOf(geometry, budget)]++;
  into.asPlaced[classOf(placed, budget)]++;
}

const WIDTH = 640;
const HEIGHT = 190;
const LEFT = 56;
const TOP = 14;
const BOTTOM = 40;

/** "0.5 to 0.7", "over 2.2" */
export function className(k: number): string {
  if (k === 0) return `up to ${BREAKS[0]}`;
  return k === BREAKS.length ? `over ${BREAKS[k - 1]}` : `${BREAKS[k - 1]} to ${BREAKS[k]}`;
}

export function histogramPanel(of: Histogram): HTMLElement | null {
  const most = Math.max(...of.asGeometry, ...of.asPlaced);
  if (!most) return null;
  const pitch = (WIDTH - LEFT) / of.asGeometry.length;
  const y = (n: number): number => HEIGHT - BOTTOM - ((HEIGHT - TOP - BOTTOM) * n) / most;
  const bar = (k: number, n: number, kind: string, at: number): SVGElement | null => n === 0 ? null
    : s("rect", { class: kind, x: LEFT + k * pitch + at * pitch, y: Math.min(y(n), y(0) - 1), width: 0.36 * pitch, height: Math.max(1, y(0) - y(n)) }, s("title", null, `${className(k)}: ${count(n)}`));
  const levels = [...new Set([0, Math.round(most / 2), most])].map((n) => [s("line", { class: "grid", x1: LEFT, x2: WIDTH, y1: y(n), y2: y(n) }), s("text", { class: "end", x: LEFT - 8, y: y(n) + 4 }, count(n))]);
  const edge = LEFT + (BREAKS.indexOf(1) + 1) * pitch;
  const within = of.asPlaced.slice(0, BREAKS.indexOf(1) + 1).reduce((a, b) => a + b, 0);
  const total = of.asPlaced.reduce((a, b) => a + b, 0);
  const svg = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `Problem views by cost over budget: ${count(within)} of ${count(total)} within the budget as placed; the table holds all figures` },
    ...levels.flat(), ...of.asGeometry.flatMap((n, k) => [bar(k, n, "geo", 0.12), bar(k, of.asPlaced[k], "placed", 0.52)]),
    ...BREAKS.map((b, k) => s("text", { class: b === 1 ? "mid one" : "mid", x: LEFT + (k + 1) * pitch, y: HEIGHT - BOTTOM + 16 }, String(b))),
    s("line", { class: "edge", x1: edge, x2: edge, y1: TOP - 8, y2: HEIGHT - BOTTOM + 4 }), s("text", { class: "end", x: WIDTH, y: HEIGHT - 6 }, "cost over budget"));
  const shown = of.asGeometry.map((_, k) => k).filter((k) => of.asGeometry[k] || of.asPlaced[k]);
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Problem views by cost over budget"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Cost over budget"), h("th", { scope: "col", class: "r" }, "As geometry"), h("th", { scope: "col", class: "r" }, "As placed"))),
    h("tbody", null, ...shown.map((k) => h("tr", null, h("th", { scope: "row", class: "nw" }, className(k)), h("td", { class: "r nw" }, count(of.asGeometry[k])), h("td", { class: "r nw" }, count(of.asPlaced[k]))))));
  const button = csvButton("views-by-cost", ["cost_over_budget", "as_geometry", "as_placed"], () => of.asGeometry.map((n, k) => [className(k), n, of.asPlaced[k]]));
  return part("hg-h", "Problem views by cost", "bounds over the budget; the line is the budget", button,
    h("div", { class: "curve histo" }, h("div", null, svg, h("p", { class: "key" }, h("span", null, h("i", { class: "block geo" }), "as geometry"), h("span", null, h("i", { class: "block placed" }), "as placed"))), scroller(table)));
}
