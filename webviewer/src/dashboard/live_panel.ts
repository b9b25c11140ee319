/** Memory and unsolved views over the time that the optimiser runs: append only, at most four redraws a second. */
import { bytes, count } from "../ui/format";
import { csv, download } from "../ui/csv";
import { h, s } from "./element";
import { clock } from "./format";
import { ticks, type Live, type LivePoint } from "./live";
import { Redraw } from "./redraw";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [400, 124, 44, 330, 18, 100];

export class LivePanel {
  readonly element = h("section", { class: "panel", "aria-labelledby": "lh" });
  private readonly said = h("span", { class: "small q" });
  private readonly memory = chart();
  private readonly unsolved = chart();
  private readonly button = h("button", { class: "btn plain", type: "button", "aria-label": "Curves as CSV", disabled: true, onclick: () => this.save() }, "CSV");
  private readonly redraw = new Redraw(() => this.draw());

  constructor(private readonly live: Live, private readonly name: string) {
    this.element.append(h("header", null, h("h2", { id: "lh" }, "Optimiser"), h("div", { class: "end" }, this.said, this.button)), this.memory, this.unsolved);
    this.draw();
  }

  changed(): void {
    this.redraw.soon();
  }

  draw(): void {
    this.redraw.done();
    const { points, hopeless } = this.live;
    const last = points.at(-1);
    this.said.textContent = last ? `updated ${clock(last.atMs)}` : "begins with the stage placement";
    this.button.disabled = !last;
    const mb = last && last.bytes >= 1e5 ? 1e6 : 1e3;
    plot(this.memory, `impostor memory, ${mb === 1e6 ? "MB" : "kB"}`, points, (p) => p.bytes / mb, last ? bytes(last.bytes) : "", "", null);
    plot(this.unsolved, "unsolved problem views", points, (p) => p.unsolved, last ? count(last.unsolved) : "", "ink", hopeless || null);
  }

  private save(): void {
    const [first] = this.live.points;
    download(`${this.name}-optimiser.csv`, csv(["seconds", "bytes", "unsolved_views"], this.live.points.map((p) => [(p.atMs - first.atMs) / 1000, p.bytes, p.unsolved])));
  }
}

function chart(): SVGSVGElement {
  return s("svg", { class: "chart live", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
}

function plot(svg: SVGSVGElement, title: string, points: readonly LivePoint[], value: (p: LivePoint) => number, end: string, tone: string, floor: number | null): void {
  const first = points[0]?.atMs ?? 0;
  const seconds = Math.max(1, ((points.at(-1)?.atMs ?? 0) - first) / 1000);
  const [unit, word] = seconds > 180 ? [60, "min"] : [1, "s"];
  const across = ticks(seconds / unit, 4);
  const up = ticks(points.reduce((most, p) => Math.max(most, value(p)), floor ?? 0), 3);
  const x = (v: number): number => LEFT + ((RIGHT - LEFT) * v) / (seconds / unit);
  const y = (v: number): number => BOTTOM - ((BOTTOM - TOP) * v) / up[up.length - 1];
  const at = (p: LivePoint): string => `${x((p.atMs - first) / 1000 / unit).toFixed(1)} ${y(value(p)).toFixed(1)}`;
  const line = points.map((p, k) => `${k ? "L" : "M"}${at(p)}`).join("");
  const last = points.at(-1);
  svg.setAttribute("aria-label", last ? `${title}: ${end} after ${Math.round(seconds)} s${floor ? `, of which ${floor} are hopeless` : ""}` : `${title}: nothing yet`);
  svg.replaceChildren(
    s("text", { x: LEFT, y: 11 }, title),
    ...up.flatMap((v) => [s("path", { class: "gr", d: `M${LEFT} ${y(v).toFixed(1)}H${RIGHT}` }), s("text", { class: "e", x: LEFT - 6, y: y(v) + 4 }, axis(v))]),
    ...across.filter((v) => v <= seconds / unit).map((v) => s("text", { class: v ? "m" : "", x: x(v), y: BOTTOM + 15 }, v === 0 ? `0 ${word}` : axis(v))),
    s("path", { class: "ax", d: `M${LEFT} ${TOP}V${BOTTOM}H${RIGHT}` }),
    ...(last && tone === "" ? [s("path", { class: "fillA", d: `${line}V${BOTTOM}H${x(0)}z` })] : []),
    ...(floor ? [s("path", { class: "ln ov dash", d: `M${LEFT} ${y(floor).toFixed(1)}H${RIGHT}` }), s("text", { class: "o", x: RIGHT + 6, y: Math.min(BOTTOM, y(floor) + 4) }, `${count(floor)} hopeless`)] : []),
    ...(last ? [s("path", { class: `ln ${tone}`, d: line }), s("circle", { class: "own", cx: x((last.atMs - first) / 1000 / unit), cy: y(value(last)), r: 3.5 }),
      ...(floor && Math.abs(y(floor) - y(value(last))) < 12 ? [] : [s("text", { class: tone ? "b" : "a", x: RIGHT + 6, y: y(value(last)) + 4 }, end)])] : []));
}

function axis(v: number): string {
  return v >= 1e4 ? `${Math.round(v / 1e3)}k` : String(Number(v.toPrecision(3)));
}
