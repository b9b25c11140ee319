/** Frame time as predicted against as measured, a point a frame: what lies below the diagonal took longer than predicted. */
import type { Sample } from "../calibrate/plan";
import { h, s } from "./element";
import { ticks } from "./live";
import { Redraw } from "./redraw";

export interface Measured extends Sample {
  predictedMs: number | null; // null: nothing was fitted yet
  seen: boolean; // the fit knew this frame
}

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [400, 300, 44, 388, 22, 262];

export class DevicePlot {
  readonly element = h("figure", { class: "plot" });
  private readonly svg = s("svg", { class: "chart", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  private readonly said = h("figcaption", { class: "small q" });
  private readonly redraw = new Redraw(() => this.draw());
  private points: readonly Measured[] = [];

  constructor() {
    this.element.append(this.svg, this.said);
    this.draw();
  }

  show(points: readonly Measured[]): void {
    this.points = points;
    this.redraw.soon();
  }

  private draw(): void {
    this.redraw.done();
    const { points } = this;
    const most = points.reduce((m, p) => Math.max(m, p.ms, p.predictedMs ?? 0), 1);
    const marks = ticks(most, 4);
    const top = marks[marks.length - 1];
    const x = (v: number): number => LEFT + ((RIGHT - LEFT) * v) / top;
    const y = (v: number): number => BOTTOM - ((BOTTOM - TOP) * v) / top;
    const dot = (p: Measured): string => `M${x(p.ms).toFixed(1)} ${y(p.predictedMs!).toFixed(1)}h.01`;
    const fitted = points.filter((p) => p.predictedMs !== null);
    const under = fitted.filter((p) => p.ms > p.predictedMs!);
    const within = fitted.filter((p) => p.ms <= p.predictedMs!);
    const open = points.filter((p) => p.predictedMs === null);
    const share = fitted.length ? `${under.length} of ${fitted.length} frames took longer than predicted` : points.length ? `${points.length} frames measured; predictions begin with the first fit` : "nothing measured yet";
    this.said.textContent = share;
    this.svg.setAttribute("aria-label", `Predicted over measured frame time: ${share}`);
    this.svg.replaceChildren(
      s("text", { x: LEFT, y: 12 }, "predicted, ms"),
      ...marks.flatMap((v) => [s("path", { class: "gr", d: `M${LEFT} ${y(v).toFixed(1)}H${RIGHT}M${x(v).toFixed(1)} ${TOP}V${BOTTOM}` }),
        s("text", { class: "e", x: LEFT - 6, y: y(v) + 4 }, String(Number(v.toPrecision(3)))), s("text", { class: v ? "m" : "", x: x(v), y: BOTTOM + 15 }, String(Number(v.toPrecision(3))))]),
      s("text", { class: "e", x: RIGHT, y: BOTTOM + 32 }, "measured, ms"),
      s("path", { class: "ln ink dash", d: `M${x(0)} ${y(0)}L${x(top)} ${y(top)}` }),
      s("path", { class: "dots open", d: open.map((p) => `M${x(p.ms).toFixed(1)} ${BOTTOM}v-5`).join("") }),
      s("path", { class: "dots in", d: within.map(dot).join("") }),
      s("path", { class: "dots under", d: under.map((p) => `M${(x(p.ms) - 3).toFixed(1)} ${(y(p.predictedMs!) - 3).toFixed(1)}l6 6m0 -6l-6 6`).join("") }));
  }
}
