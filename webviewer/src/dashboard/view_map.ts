/**
 * The view space from above: cells by their worst predicted cost over the budget, as plain geometry; hopeless ones are
 * hatched. While the optimiser runs, also by how many of their views are still unsolved.
 */
import type { Box } from "../api/types";
import { cost as costText, count } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { BREAKS, classOf } from "./cell_classes";
import { h, s } from "./element";
import { metres, plural } from "./format";
import type { MapData } from "./map_data";
import { boxesPath, planeOf, viewBoxOf, type Plane } from "./scene_plan";

const BREAK_TEXT = BREAKS.map((b) => (b === 1 ? "1" : String(b).replace(/^0/, "")));
const FEW = [1, 2, 3, 5, 7, 10]; // unsolved views: from here on the next class
const ZOOMS = [1, 2, 4, 8, 16];

type Mode = "cost" | "unsolved";

/** Least counts of the classes 1 to 6, for cells of up to `most` views. */
export function unsolvedBreaks(most: number): number[] {
  let factor = 1;
  for (let k = 0; 30 * factor < most; k++) factor = [1, 2, 5][(k + 1) % 3] * 10 ** Math.floor((k + 1) / 3);
  return FEW.map((n) => n * factor);
}

export class ViewMap {
  readonly element = h("section", { class: "panel", "aria-labelledby": "mh" });
  private readonly whole: Plane;
  private readonly picture: SVGSVGElement;
  private readonly cells = s("g", { class: "cells" });
  private readonly mark = s("g");
  private readonly scaleBar = h("div", { class: "mapbar" });
  private readonly foot = h("div", { class: "mapfoot" });
  private readonly pick = h("div", { class: "pick", role: "status" });
  private readonly hint = h("span", { class: "small q" });
  private readonly modes = h("div", { class: "end seg noprint", role: "radiogroup", "aria-label": "Colour by", hidden: true });
  private readonly breaks: number[];
  private mode: Mode = "cost";
  private zoom = 0;
  private plane: Plane;
  private at = -1;

  /** `placement`: where cells open in the viewer; null: there is none yet. */
  constructor(private readonly data: MapData, private readonly placement: string | null) {
    this.whole = this.plane = planeOf(data.cells.map((c) => c.box), 1.5);
    this.breaks = unsolvedBreaks(data.cells.reduce((most, c) => Math.max(most, c.views), 0));
    this.picture = s("svg", { viewBox: viewBoxOf(this.plane), "aria-hidden": "true" }, hatch(this.plane), this.cells, ...this.overlays(), this.mark);
    const opens = placement === null ? "" : ", V opens it in the viewer";
    const map = h("div", { class: "map", tabindex: "0", role: "application", "aria-label": `Map of the view space from above; arrow keys move the selected cell, plus and minus zoom${opens}` }, this.picture, this.scaleBar, this.zoomButtons());
    this.picture.addEventListener("pointerdown", (e) => this.select(this.under(e)));
    map.addEventListener("focus", () => this.at < 0 && this.select(this.worst()));
    map.addEventListener("keydown", (e) => this.arrow(e));
    for (const [mode, word] of [["cost", "Worst predicted cost"], ["unsolved", "Unsolved now"]] as const) {
      this.modes.append(h("label", null, h("input", { type: "radio", name: "map-mode", value: mode, checked: mode === "cost", onchange: () => this.setMode(mode) }), h("span", null, word)));
    }
    this.element.append(h("header", null, h("h2", { id: "mh" }, "View space from above"), this.hint, this.modes), map, this.foot, this.pick);
    this.draw();
    this.frame();
    this.select(this.worst());
  }

  /** Counts of unsolved views by cell, while somebody works on them. */
  setUnsolved(counts: readonly number[]): void {
    const first = this.modes.hidden;
    this.modes.hidden = false;
    this.data.cells.forEach((c, k) => (c.unsolved = counts[k] ?? 0));
    if (first) this.setMode("unsolved");
    else if (this.mode === "unsolved") this.draw();
    if (this.at >= 0) this.select(this.at);
  }

  /** Keys of the page: M mode, V viewer, + and - zoom; whether this was one. */
  key(key: string): boolean {
    if (key === "m" && !this.modes.hidden) this.setMode(this.mode === "cost" ? "unsolved" : "cost");
    else if (key === "v" && this.placement !== null && this.at >= 0) location.assign(this.address(this.placement, this.at));
    else if (key === "+" || key === "=") this.setZoom(this.zoom + 1);
    else if (key === "-") this.setZoom(this.zoom - 1);
    else return false;
    return true;
  }

  /** Selects the cell, from outside too. */
  select(at: number): void {
    if (at < 0 || at >= this.data.cells.length) return;
    const moved = at !== this.at;
    this.at = at;
    const c = this.data.cells[at];
    const d = boxesPath([c.box], this.whole);
    this.mark.replaceChildren(s("path", { class: "sel-h", d }), s("path", { class: "sel-c", d }));
    if (moved && this.zoom) this.frame();
    const over = c.cost > this.data.budget;
    const fact = (name: string, value: string, kind = ""): HTMLElement => h("div", null, h("span", null, name), h("b", kind ? { class: kind } : null, value));
    const last = c.unsolved >= 0 ? fact("unsolved", count(c.unsolved)) : fact("hopeless", count(c.hopeless));
    this.pick.replaceChildren(fact("cell", String(c.cell), "mono"), fact("worst", costText(c.cost, this.data.unit), over ? "over" : "good"),
      fact("problem views", c.views < 0 ? "—" : count(c.views)), last,
      this.placement === null ? "" : h("a", { class: "noprint", href: this.address(this.placement, at) }, "Stand there in the viewer"));
  }

  private setMode(mode: Mode): void {
    this.mode = mode;
    for (const input of this.modes.querySelectorAll("input")) input.checked = input.value === mode;
    this.draw();
  }

  private setZoom(zoom: number): void {
    this.zoom = Math.max(0, Math.min(ZOOMS.length - 1, zoom));
    this.frame();
  }

  private address(placement: string, at: number): string {
    const [a, b] = this.data.cells[at].box;
    return viewAddress(placement, [0, 1, 2].map((k) => (a[k] + b[k]) / 2), [0, 0, -1]);
  }

  private worst(): number {
    let best = 0;
    this.data.cells.forEach((c, k) => {
      const w = this.data.cells[best];
      if (c.hopeless > w.hopeless || (c.hopeless === w.hopeless && c.cost > w.cost)) best = k;
    });
    return best;
  }

  /** One path a class: a level has thousands of cells. */
  private draw(): void {
    const { cells, budget } = this.data;
    const cost = this.mode === "cost";
    const byClass: Box[][] = Array.from({ length: 9 }, () => []);
    for (const c of cells) byClass[cost ? classOf(c.cost, budget) : this.breaks.filter((b) => c.unsolved >= b).length].push(c.box);
    // Cells may lie above each other: the worst is drawn last.
    this.cells.replaceChildren(...byClass.flatMap((boxes, k) => (boxes.length ? [s("path", { class: `${cost ? "c" : "u"}${k}`, d: boxesPath(boxes, this.whole) })] : [])));
    this.hint.textContent = cost ? "worst predicted cost of each cell without impostors" : "problem views that no choice has solved yet";
    this.foot.replaceChildren(this.legend(cost), this.hatchLegend());
  }

  private overlays(): SVGElement[] {
    const hopeless = this.data.cells.filter((c) => c.hopeless > 0).map((c) => c.box);
    const area = (this.plane.high[0] - this.plane.low[0]) * (this.plane.high[1] - this.plane.low[1]);
    const near = this.data.footprints.filter(([a, b]) => a[0] < this.plane.high[0] && b[0] > this.plane.low[0] && a[2] < this.plane.high[1] && b[2] > this.plane.low[1] && (b[0] - a[0]) * (b[2] - a[2]) < 0.25 * area);
    return [s("path", { fill: "url(#hatch)", d: boxesPath(hopeless, this.plane) }), s("path", { class: "foot-p", d: boxesPath(near, this.plane) })];
  }

  /** Shows the part that the zoom leaves, about the selected cell. */
  private frame(): void {
    const { low, high } = this.whole;
    const share = 1 / ZOOMS[this.zoom];
    const box = this.data.cells[Math.max(0, this.at)]?.box;
    const part = ([0, 1] as const).map((a) => {
      const size = (high[a] - low[a]) * share;
      const middle = box ? (box[0][2 * a] + box[1][2 * a]) / 2 : low[a];
      const from = Math.max(low[a], Math.min(high[a] - size, middle - size / 2));
      return [from, from + size];
    });
    this.plane = { low: [part[0][0], part[1][0]], high: [part[0][1], part[1][1]] };
    this.picture.setAttribute("viewBox", viewBoxOf(this.plane));
    const wide = high[0] - low[0];
    const power = 10 ** Math.floor(Math.log10((wide * share) / 5));
    const length = [5, 2, 1].map((m) => m * power).find((l) => l <= (wide * share) / 5) ?? power;
    this.scaleBar.replaceChildren(`${metres(length)} m`, h("i", { css: { "--at": `${(100 * length) / (wide * share)}cqw` } }));
  }

  private under(e: PointerEvent): number {
    const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(this.picture.getScreenCTM()!.inverse());
    return this.nearest([p.x, p.y]);
  }

  /** The worst cell that holds the point, else the nearest. */
  private nearest([x, z]: [number, number]): number {
    let best = -1;
    let least = Infinity;
    this.data.cells.forEach((c, k) => {
      const [a, b] = c.box;
      const far = Math.hypot(Math.max(a[0] - x, 0, x - b[0]), Math.max(a[2] - z, 0, z - b[2]));
      if (far < least || (far === least && best >= 0 && c.cost > this.data.cells[best].cost)) [best, least] = [k, far];
    });
    return best;
  }

  private arrow(e: KeyboardEvent): void {
    const move = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] } as Record<string, [number, number]>)[e.key];
    if (!move || this.at < 0) return;
    e.preventDefault();
    e.stopPropagation();
    const [a, b] = this.data.cells[this.at].box;
    const from = [(a[0] + b[0]) / 2, (a[2] + b[2]) / 2];
    let best = this.at;
    let least = Infinity;
    this.data.cells.forEach((c, k) => {
      const to = [(c.box[0][0] + c.box[1][0]) / 2 - from[0], (c.box[0][2] + c.box[1][2]) / 2 - from[1]];
      const along = to[0] * move[0] + to[1] * move[1];
      if (along <= 1e-9) return;
      const across = Math.abs(to[0] * move[1]) + Math.abs(to[1] * move[0]);
      const far = along + 3 * across;
      if (far < least) [best, least] = [k, far];
    });
    this.select(best);
  }

  private zoomButtons(): HTMLElement {
    const button = (name: string, text: string, by: number): HTMLElement => h("button", { type: "button", "aria-label": name, onclick: () => this.setZoom(this.zoom + by) }, text);
    return h("div", { class: "zoom noprint" }, button("Zoom in on the selected cell", "+", 1), button("Zoom out", "−", -1));
  }

  private legend(cost: boolean): HTMLElement {
    const texts = cost ? [...BREAK_TEXT, ""] : this.breaks.map(String);
    const steps = cost
      ? texts.map((t, k) => h("li", null, h("span", { class: `bg${k}` }), h("b", t === "1" ? { class: "one" } : null, t)))
      : ["0", ...texts].map((t, k) => h("li", null, h("span", { class: `bu${k}` }), h("b", null, k === 6 ? `${t}+` : t)));
    return h("div", { class: "scale" }, h("span", null, cost ? `predicted / ${costText(this.data.budget, this.data.unit)}` : "unsolved views in a cell"), h("ol", cost ? { class: "edge" } : null, ...steps));
  }

  private hatchLegend(): HTMLElement | string {
    if (!this.data.cells.some((c) => c.hopeless)) return "";
    const sample = s("svg", { width: 22, height: 12, viewBox: "0 0 22 12", "aria-hidden": "true" }, s("rect", { width: 22, height: 12, class: "c7" }), ...[0, 6, 12, 18].flatMap((x) => [s("path", { d: `M${x} 14l14 -14`, class: "hop-b", "stroke-width": 3.4 }), s("path", { d: `M${x} 14l14 -14`, class: "hop-i", "stroke-width": 1.5 })]));
    return h("span", { class: "scale" }, sample, this.data.complete ? "hopeless" : `hopeless, the worst ${plural(100, "view")}`);
  }
}

/** Two tones, seen on any class. */
function hatch(plane: Plane): SVGDefsElement {
  const side = (plane.high[0] - plane.low[0]) / 130;
  return s("defs", null, s("pattern", { id: "hatch", width: side, height: side, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    s("path", { d: `M${side / 4} 0V${side}`, class: "hop-b", "stroke-width": side * 0.56 }), s("path", { d: `M${side / 4} 0V${side}`, class: "hop-i", "stroke-width": side * 0.25 })));
}
