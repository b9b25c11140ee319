/**
 * The view space from above: cells by their worst predicted cost over the budget, as plain geometry; hopeless ones are
 * hatched. Read from the placement's index; hopeless cells from the report, or from the chunks where it lists not all.
 */
import type { Report } from "./report_types";
import type { Box } from "../api/types";
import { Placement } from "../placementdb/placement";
import { fetchFrom, makeTraffic } from "../stream/files";
import { cost as costText } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { BREAKS, classOf } from "./cell_classes";
import { h, s } from "./element";
import { metres } from "./format";
import { addView, emptyHistogram, type Histogram } from "./histogram";
import { boxesPath, planeOf, viewBoxOf, type Plane } from "./scene_plan";

export interface MapCell {
  box: Box;
  cost: number; // worst bound of its views as geometry, per_frame included
  cell: number;
  views: number; // problem views; -1: not known
  hopeless: number;
}

export interface MapData {
  cells: MapCell[];
  footprints: Box[];
  budget: number;
  unit: string;
  views: Histogram | null; // null: there are too many to read them all
  complete: boolean; // false: hopeless views were read from the report alone, which lists the worst
}

const CHUNK_BYTES = 32e6; // hopeless cells are not worth more than that to a page
const BREAK_TEXT = BREAKS.map((b) => (b === 1 ? "1" : String(b).replace(/^0/, "")));

/** Reads what the map shows of a placement. */
export async function readMap(placement: string, report: Report): Promise<MapData> {
  const p = await Placement.open(fetchFrom(`/v1/placements/${encodeURIComponent(placement)}/`, makeTraffic()));
  const { manifest, index } = p;
  const box = (from: Float64Array, k: number): Box => {
    const at = (i: number): number => from[6 * k + i] + manifest.origin_m[i % 3];
    return [[at(0), at(1), at(2)], [at(3), at(4), at(5)]];
  };
  const cells: MapCell[] = Array.from(index.cellNode, (node, cell) => ({
    box: box(index.nodeBox, node), cost: index.cellCost[cell] + manifest.cost_model.per_frame, cell, views: 0, hopeless: 0,
  }));
  const hopeless = manifest.counts.hopeless_views;
  const size = manifest.chunks.reduce((sum, c) => sum + c.bytes, 0);
  const listed = report.hopeless?.length ?? 0;
  const complete = hopeless <= listed || size <= CHUNK_BYTES;
  let views: Histogram | null = null;
  if (size <= CHUNK_BYTES) {
    views = emptyHistogram();
    const fixed = manifest.cost_model.per_frame;
    for (let k = 0; k < manifest.chunks.length; k++) {
      const chunk = await p.chunk(k);
      for (let c = chunk.cells[0]; c < chunk.cells[1]; c++) {
        const [a, b] = [chunk.cellView[c - chunk.cells[0]], chunk.cellView[c - chunk.cells[0] + 1]];
        cells[c].views = b - a;
        for (let v = a; v < b; v++) {
          cells[c].hopeless += chunk.viewHopeless[v];
          addView(views, chunk.viewGeometryCost[v] + fixed, chunk.viewCost[v] + fixed, manifest.budget.amount);
        }
      }
      p.dropChunk(k);
    }
  } else {
    for (const c of cells) c.views = -1;
    for (const view of report.hopeless ?? []) if (cells[view.cell]) cells[view.cell].hopeless++;
  }
  const footprints = Array.from({ length: manifest.counts.objects }, (_, k) => box(index.objectBox, k));
  return { cells, footprints, budget: manifest.budget.amount, unit: manifest.budget.unit, views, complete };
}

export class ViewMap {
  readonly element = h("section", { class: "panel", "aria-labelledby": "mh" });
  private readonly plane: Plane;
  private readonly mark = s("g");
  private readonly pick = h("div", { class: "pick", role: "status" });
  private at = -1;

  constructor(private readonly data: MapData, private readonly placement: string) {
    this.plane = planeOf(data.cells.map((c) => c.box), 1.5);
    const picture = s("svg", { viewBox: viewBoxOf(this.plane), "aria-hidden": "true" }, hatch(this.plane), ...this.layers(), this.mark);
    const map = h("div", { class: "map", tabindex: "0", role: "application", "aria-label": "Map of the view space from above; arrow keys move the selected cell, V opens it in the viewer" }, picture, this.scaleBar());
    map.addEventListener("pointerdown", (e) => this.select(this.under(picture, e)));
    map.addEventListener("focus", () => this.at < 0 && this.select(this.worst()));
    map.addEventListener("keydown", (e) => this.key(e));
    this.element.append(h("header", null, h("h2", { id: "mh" }, "View space from above"), h("span", { class: "small q" }, "worst predicted cost of each cell without impostors")), map, this.legend(), this.pick);
    this.select(this.worst());
  }

  /** Selects the cell, from outside too. */
  select(at: number): void {
    if (at < 0 || at >= this.data.cells.length) return;
    this.at = at;
    const c = this.data.cells[at];
    const d = boxesPath([c.box], this.plane);
    this.mark.replaceChildren(s("path", { class: "sel-h", d }), s("path", { class: "sel-c", d }));
    const over = c.cost > this.data.budget;
    const fact = (name: string, value: string, kind = ""): HTMLElement => h("div", null, h("span", null, name), h("b", kind ? { class: kind } : null, value));
    this.pick.replaceChildren(fact("cell", String(c.cell), "mono"), fact("worst", costText(c.cost, this.data.unit), over ? "over" : "good"),
      fact("problem views", c.views < 0 ? "—" : String(c.views)), fact("hopeless", String(c.hopeless)), h("a", { class: "noprint", href: this.address(at) }, "Stand there in the viewer"));
  }

  private address(at: number): string {
    const [a, b] = this.data.cells[at].box;
    return viewAddress(this.placement, [0, 1, 2].map((k) => (a[k] + b[k]) / 2), [0, 0, -1]);
  }

  private worst(): number {
    let best = 0;
    this.data.cells.forEach((c, k) => {
      const w = this.data.cells[best];
      if (c.hopeless > w.hopeless || (c.hopeless === w.hopeless && c.cost > w.cost)) best = k;
    });
    return best;
  }

  private layers(): SVGElement[] {
    const byClass: Box[][] = Array.from({ length: 9 }, () => []);
    for (const c of this.data.cells) byClass[classOf(c.cost, this.data.budget)].push(c.box);
    // Cells may lie above each other: the worst is drawn last.
    const cells = s("g", { class: "cells" }, ...byClass.map((boxes, k) => (boxes.length ? s("path", { class: `c${k}`, d: boxesPath(boxes, this.plane) }) : null)));
    const hopeless = this.data.cells.filter((c) => c.hopeless > 0).map((c) => c.box);
    const area = (this.plane.high[0] - this.plane.low[0]) * (this.plane.high[1] - this.plane.low[1]);
    const near = this.data.footprints.filter(([a, b]) => a[0] < this.plane.high[0] && b[0] > this.plane.low[0] && a[2] < this.plane.high[1] && b[2] > this.plane.low[1] && (b[0] - a[0]) * (b[2] - a[2]) < 0.25 * area);
    return [cells, s("path", { fill: "url(#hatch)", d: boxesPath(hopeless, this.plane) }), s("path", { class: "foot-p", d: boxesPath(near, this.plane) })];
  }

  private under(picture: SVGSVGElement, e: PointerEvent): number {
    const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(picture.getScreenCTM()!.inverse());
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

  private key(e: KeyboardEvent): void {
    const move = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] } as Record<string, [number, number]>)[e.key];
    if (e.key.toLowerCase() === "v" && this.at >= 0) location.assign(this.address(this.at));
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

  private scaleBar(): HTMLElement {
    const wide = this.plane.high[0] - this.plane.low[0];
    const power = 10 ** Math.floor(Math.log10(wide / 5));
    const length = [5, 2, 1].map((m) => m * power).find((l) => l <= wide / 5) ?? power;
    return h("div", { class: "mapbar" }, `${metres(length)} m`, h("i", { css: { "--at": `${(100 * length) / wide}cqw` } }));
  }

  private legend(): HTMLElement {
    const budget = costText(this.data.budget, this.data.unit);
    const steps = [...BREAK_TEXT, ""].map((t, k) => h("li", null, h("span", { class: `bg${k}` }), h("b", t === "1" ? { class: "one" } : null, t)));
    const sample = s("svg", { width: 22, height: 12, viewBox: "0 0 22 12", "aria-hidden": "true" }, s("rect", { width: 22, height: 12, class: "c7" }), ...[0, 6, 12, 18].flatMap((x) => [s("path", { d: `M${x} 14l14 -14`, class: "hop-b", "stroke-width": 3.4 }), s("path", { d: `M${x} 14l14 -14`, class: "hop-i", "stroke-width": 1.5 })]));
    const anywhere = this.data.cells.some((c) => c.hopeless);
    return h("div", { class: "mapfoot" }, h("div", { class: "scale" }, h("span", null, `predicted / ${budget}`), h("ol", { class: "edge" }, ...steps)),
      anywhere ? h("span", { class: "scale" }, sample, this.data.complete ? "hopeless" : "hopeless, the worst 100 views") : null);
  }
}

/** Two tones, seen on any class. */
function hatch(plane: Plane): SVGDefsElement {
  const side = (plane.high[0] - plane.low[0]) / 130;
  return s("defs", null, s("pattern", { id: "hatch", width: side, height: side, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    s("path", { d: `M${side / 4} 0V${side}`, class: "hop-b", "stroke-width": side * 0.56 }), s("path", { d: `M${side / 4} 0V${side}`, class: "hop-i", "stroke-width": side * 0.25 })));
}
