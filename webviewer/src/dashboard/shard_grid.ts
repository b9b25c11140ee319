/** Shards as squares that fill: the fill is the state, a dot a retry. At most four redraws a second. */
import { h, s } from "./element";
import { duration, plural } from "./format";
import { squares, type JobState, type Shard, type Square } from "./job_state";
import { Redraw } from "./redraw";
import { bytes } from "../ui/format";

const COLUMNS = 40;
const PITCH = 10;
const WORKING = 6;

interface Row {
  svg: SVGSVGElement;
  list: Shard[];
  shown: Square[];
  at: number;
}

export class ShardGrid {
  readonly element = h("section", { class: "panel", "aria-labelledby": "sh" });
  private readonly count = h("div", { class: "end small q" });
  private readonly rows = h("div", { class: "sh" });
  private readonly working = h("tbody");
  private readonly tip = h("p", { class: "tip", role: "status" });
  private readonly held = new Map<string, Row>();
  private readonly redraw = new Redraw(() => this.draw());
  private only: string | null = null;

  /** `chosen` hears which shard is clicked, or named by Enter, as the log calls it. */
  constructor(private readonly state: JobState, private readonly chosen: (who: string) => void) {
    this.element.append(h("header", null, h("h2", { id: "sh" }, "Shards"), this.count), this.rows, key(), this.tip,
      h("table", { class: "wk" }, h("caption", { class: "sr" }, "Working now"), this.working));
  }

  filter(stage: string | null): void {
    this.only = stage;
    this.draw();
  }

  /** Draws soon. */
  changed(): void {
    this.redraw.soon();
  }

  draw(): void {
    this.redraw.done();
    let total = 0;
    let ended = 0;
    let retried = 0;
    const running: { stage: string; who: string; shard: Shard }[] = [];
    for (const [stage, kinds] of this.state.shards) {
      const list = kinds.get("run") ?? [];
      for (const shard of list) {
        if (!shard) continue;
        total++;
        ended += Number(shard.state === "done");
        retried += Number(shard.attempt > 1);
      }
      for (const [kind, shards] of kinds) {
        shards.forEach((shard, k) => shard?.state === "running" && running.push({ stage, who: kind === "run" ? `${stage} ${k + 1}` : `${stage}, ${kind}`, shard }));
      }
      if (list.length) this.drawRow(stage, list);
    }
    this.count.textContent = total ? `${ended.toLocaleString("en")} of ${total.toLocaleString("en")} done${retried ? `, ${retried} retried` : ""}` : "none yet";
    this.working.replaceChildren(...running.slice(0, WORKING).map(({ who, shard }) => h("tr", null, h("td", null, who),
      h("td", { class: "r" }, shard.sinceMs ? duration(Math.max(0, Date.now() - shard.sinceMs) / 1000) : ""),
      h("td", { class: "r q mono" }, shard.worker?.split(":").slice(1, 2).map((slot) => `worker ${slot}`)[0] ?? ""))));
    if (running.length > WORKING) this.working.append(h("tr", null, h("td", { class: "q" }, `and ${running.length - WORKING} more`)));
  }

  private drawRow(stage: string, list: Shard[]): void {
    let row = this.held.get(stage);
    if (!row) {
      const svg = s("svg", { role: "img", tabindex: "0" });
      row = { svg, list, shown: [], at: 0 };
      this.held.set(stage, row);
      this.rows.append(h("div", { "data-stage": stage }, h("span", null, stage), svg, h("span", { class: "r nw" })));
      this.listen(stage, row);
    }
    const line = row.svg.parentElement as HTMLElement;
    line.hidden = this.only !== null && this.only !== stage;
    row.list = list;
    row.shown = squares(list);
    const done = list.reduce((n, x) => n + Number(x?.state === "done"), 0);
    line.lastElementChild!.textContent = `${done.toLocaleString("en")} / ${list.length.toLocaleString("en")}`;
    row.svg.setAttribute("aria-label", `${stage}: ${done} of ${plural(list.length, "shard")} done; arrow keys name one, Enter shows its log`);
    const height = Math.ceil(row.shown.length / COLUMNS) * PITCH;
    row.svg.setAttribute("viewBox", `0 0 ${COLUMNS * PITCH} ${height}`);
    row.svg.replaceChildren(...paths(row.shown));
  }

  private listen(stage: string, row: Row): void {
    const name = (at: number): void => {
      row.at = Math.max(0, Math.min(row.shown.length - 1, at));
      this.tip.textContent = describe(stage, row, row.at);
      row.svg.querySelector(".sel")?.remove();
      row.svg.append(s("path", { class: "sel", d: square(row.at) }));
    };
    row.svg.addEventListener("pointermove", (e) => {
      const r = row.svg.getBoundingClientRect();
      const scale = (COLUMNS * PITCH) / r.width;
      const at = Math.floor(((e.clientY - r.top) * scale) / PITCH) * COLUMNS + Math.floor(((e.clientX - r.left) * scale) / PITCH);
      if (at < row.shown.length) name(at);
    });
    row.svg.addEventListener("focus", () => name(row.at));
    const choose = (): void => {
      if (row.shown[row.at]?.count === 1) this.chosen(`${stage} ${row.shown[row.at].first + 1}`);
    };
    row.svg.addEventListener("click", choose);
    row.svg.addEventListener("keydown", (e) => {
      if (e.key === "Enter") return choose();
      const by = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: COLUMNS, ArrowUp: -COLUMNS }[e.key];
      if (by === undefined) return;
      e.preventDefault();
      e.stopPropagation();
      name(row.at + by);
    });
  }
}

function square(at: number, top = 0): string {
  const x = (at % COLUMNS) * PITCH + 0.5;
  const y = Math.floor(at / COLUMNS) * PITCH + 0.5 + top;
  return `M${x} ${y}h7v${7 - top}h-7z`;
}

const CLASS = { done: "x-d", running: "x-r", ready: "x-w", failed: "x-f", cancelled: "x-c" } as const;

/** One path a state: a stage may have thousands of squares. */
function paths(shown: readonly Square[]): SVGElement[] {
  const d: Record<string, string> = {};
  const dots: SVGElement[] = [];
  shown.forEach((sq, at) => {
    d[CLASS[sq.state]] = (d[CLASS[sq.state]] ?? "") + square(at);
    if (sq.state === "running") d["x-h"] = (d["x-h"] ?? "") + square(at, 4);
    if (sq.retried && sq.state === "done") dots.push(s("circle", { class: "x-t", cx: (at % COLUMNS) * PITCH + 4, cy: Math.floor(at / COLUMNS) * PITCH + 4, r: 1.6 }));
  });
  return [...["x-w", "x-c", "x-d", "x-r", "x-h", "x-f"].filter((c) => d[c]).map((c) => s("path", { class: c, d: d[c] })), ...dots];
}

function describe(stage: string, row: Row, at: number): string {
  const sq = row.shown[at];
  if (!sq) return "";
  if (sq.count > 1) return `${stage} ${sq.first + 1} to ${sq.first + sq.count}: worst is ${sq.state}`;
  const shard = row.list[sq.first];
  if (!shard) return `${stage} ${sq.first + 1}: ready`;
  const parts = [`${stage} ${sq.first + 1}: ${shard.state}${shard.cached ? ", known already" : ""}`];
  if (shard.attempt > 1) parts.push(`attempt ${shard.attempt}`);
  if (shard.seconds !== null) parts.push(duration(shard.seconds));
  if (shard.peakBytes) parts.push(`${bytes(shard.peakBytes)} at most`);
  if (shard.worker) parts.push(shard.worker);
  if (shard.error) parts.push(shard.error);
  return parts.join(" · ");
}

function key(): HTMLElement {
  const mark = (...shapes: [string, string][]): SVGSVGElement => s("svg", { viewBox: "0 0 10 10", "aria-hidden": "true" }, ...shapes.map(([c, d]) => s("path", { class: c, d })));
  const box = "M1 1h8v8h-8z";
  const retry = mark(["x-d", box]);
  retry.append(s("circle", { class: "x-t", cx: 5, cy: 5, r: 1.8 }));
  return h("div", { class: "key" }, h("span", null, mark(["x-d", box]), "done"), h("span", null, mark(["x-r", box], ["x-h", "M1 5h8v4h-8z"]), "running"),
    h("span", null, mark(["x-w", box]), "ready"), h("span", null, retry, "done on a retry"), h("span", null, mark(["x-f", box]), "failed"), h("span", null, mark(["x-c", box]), "cancelled"));
}
