/** The stages of a job in a row: bars linear in time, the longest full; skipped ones hatched, reasons in full below. */
import type { Stage } from "../api/schema";
import type { StageRow } from "../api/types";
import { bytes } from "../ui/format";
import { h, refill } from "./element";
import { duration, plural } from "./format";
import { icon, stageIcon } from "./icons";

const DOES: Record<Stage, string> = {
  scene: "reads the level into objects",
  hierarchy: "groups objects into clusters",
  detail: "makes coarser levels of detail",
  rendertime: "says what drawing each object costs",
  visibility: "finds what each cell can see",
  viewspace: "finds all views over budget",
  candidates: "weighs impostors that would help",
  placement: "picks the lightest that meet the budget",
  bake: "draws their layers",
  repair: "mends what the bake made heavier or slower",
  bound: "proves what no placement can weigh less than",
  placementdb: "writes the files that the viewer reads",
  evaluation: "checks the guarantee on random views",
  proof: "compares pictures with and without impostors",
};

export class StageStrip {
  readonly element = h("div");
  private readonly list = h("ol", { class: "stages", "aria-label": "Stages" });
  private readonly reasons = h("div", { class: "whyskip" });
  private readonly items = new Map<string, HTMLLIElement>();

  /** `chosen` hears the stage that is picked, null when none is. */
  constructor(private readonly chosen: (stage: string | null) => void) {
    this.element.append(this.list, this.reasons);
  }

  show(stages: readonly StageRow[]): void {
    const seconds = stages.map((s) => s.seconds ?? 0);
    const longest = Math.max(...seconds, 1e-3);
    stages.forEach((stage, k) => {
      let item = this.items.get(stage.name);
      if (!item) {
        const button = h("button", { type: "button", "aria-pressed": "false", title: `${k + 1}: ${DOES[stage.name] ?? stage.name}`, onclick: () => this.toggle(stage.name) });
        this.items.set(stage.name, (item = h("li", null, button)));
        this.list.append(item);
      }
      const running = icon0(stage) === "run";
      item.className = stage.state === "failed" ? "bad" : icon0(stage) === "skip" ? "skipd" : running ? "now" : "";
      const button = item.firstElementChild!;
      refill(button, JSON.stringify([stage, longest]), () => content(stage, seconds[k], longest));
    });
    const skipped = stages.filter((s) => s.skipped);
    refill(this.reasons, JSON.stringify(skipped.map((s) => s.skipped)), () =>
      skipped.map((s) => h("span", null, icon("skip"), " ", h("b", null, s.name), ` ${s.skipped!.startsWith("failed") ? "" : "skipped: "}${s.skipped}`)));
    this.reasons.hidden = !skipped.length;
  }

  pick(at: number): void {
    const name = [...this.items.keys()][at];
    if (name) this.toggle(name);
  }

  private toggle(name: string): void {
    let now: string | null = null;
    for (const [key, item] of this.items) {
      const button = item.firstElementChild!;
      const pressed = key === name && button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(pressed));
      if (pressed) now = key;
    }
    this.chosen(now);
  }
}

const icon0 = (s: StageRow): string => stageIcon(s.state, s.skipped);

/** Stages as they are now: the seconds of what runs have gone on since they were read. */
export function grown(stages: readonly StageRow[], readAtMs: number): StageRow[] {
  const since = Math.max(0, Date.now() - readAtMs) / 1000;
  return stages.map((s) => (s.seconds !== null && icon0(s) === "run" ? { ...s, seconds: s.seconds + since } : s));
}

function content(stage: StageRow, seconds: number, longest: number): Node[] {
  const shape = icon0(stage);
  const waits = stage.state === "waiting";
  const words = { skip: "skipped", queue: "waits", fail: "failed" }[shape] ?? duration(seconds);
  return [
    h("span", { class: "n" }, icon(shape), stage.name, h("span", { class: "sr" }, ` ${stage.state}`)),
    h("span", { class: `d${waits || shape === "skip" ? " q" : ""}` }, words),
    h("i", { class: `prop${seconds > 0 && shape !== "skip" ? "" : " off"}`, css: { "--at": `${(100 * seconds) / longest}%` } }),
    h("span", { class: "w" }, detail(stage)),
  ];
}

function detail(stage: StageRow): string {
  if (stage.skipped !== null) return stage.skipped;
  const { total, done } = stage.shards;
  if (stage.state === "running") return total > 1 ? `${done.toLocaleString("en")} of ${total.toLocaleString("en")}` : "";
  if (stage.state === "planning" || stage.state === "merging" || stage.state === "reporting") return stage.state;
  if (stage.state !== "done") return "";
  return [total > 1 ? plural(total, "shard") : "", stage.peak_bytes ? bytes(stage.peak_bytes) : ""].filter(Boolean).join(", ");
}
