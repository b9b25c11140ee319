/** What happened, line by line: the last one always in sight, the rest in a drawer that follows until it is scrolled. */
import { download } from "../ui/csv";
import { h, refill } from "./element";
import { clock } from "./format";
import type { JobState, Level, LogLine } from "./job_state";
import { Redraw } from "./redraw";

const WORD: Record<Level, string> = { info: "info", warn: "warn", error: "error" };
const COLOUR: Record<Level, string> = { info: "", warn: "over", error: "fail" };

export class LogDrawer {
  readonly element: HTMLDetailsElement;
  private readonly last = h("span", { class: "mono" });
  private readonly lines = h("pre", { tabindex: "0", role: "log", "aria-label": "Log" });
  private readonly follow = h("button", { type: "button", "aria-pressed": "true" }, "Follow");
  private readonly select = h("select", { "aria-label": "Stage or shard" }, h("option", { value: "" }, "all stages"));
  private readonly levels: HTMLInputElement[] = [];
  private readonly redraw = new Redraw(() => this.draw());
  private scrolling = false;
  private one: HTMLOptionElement | null = null; // a shard whose lines alone are shown

  constructor(private readonly state: JobState, private readonly name: string, stages: readonly string[]) {
    this.select.append(...stages.map((stage) => h("option", { value: stage }, stage)));
    const seg = h("div", { class: "seg", role: "radiogroup", "aria-label": "Level" });
    for (const [value, word] of [["info", "all"], ["warn", "warnings"], ["error", "errors"]]) {
      const input = h("input", { type: "radio", name: "level", value, checked: value === "info", onchange: () => this.draw() });
      this.levels.push(input);
      seg.append(h("label", null, input, h("span", null, word)));
    }
    this.select.addEventListener("change", () => this.draw());
    this.follow.addEventListener("click", () => this.setFollow(this.follow.getAttribute("aria-pressed") !== "true"));
    this.lines.addEventListener("scroll", () => {
      if (this.scrolling) return;
      this.setFollow(this.lines.scrollHeight - this.lines.scrollTop - this.lines.clientHeight < 24);
    });
    this.element = h("details", { class: "log" }, h("summary", null, h("b", null, "Log"), this.last),
      h("div", { class: "tools" }, this.select, seg, this.follow, h("button", { type: "button", onclick: () => this.save() }, "Download")), this.lines);
    this.element.addEventListener("toggle", () => this.draw());
  }

  toggle(): void {
    this.element.open = !this.element.open;
  }

  filter(stage: string | null): void {
    this.setWho(null);
    this.select.value = stage ?? "";
    this.draw();
  }

  /** The lines of one shard alone, as the log names it ("viewspace 12"). */
  only(who: string): void {
    this.setWho(who);
    this.element.open = true;
    this.draw();
  }

  private setWho(who: string | null): void {
    if (this.one) this.one.remove();
    this.one = null;
    if (who === null) return;
    this.one = h("option", { value: `=${who}` }, who);
    this.select.append(this.one);
    this.select.value = this.one.value;
  }

  changed(): void {
    this.redraw.soon();
  }

  private shown(): LogLine[] {
    const level = this.levels.find((l) => l.checked)?.value ?? "info";
    const wanted = level === "error" ? ["error"] : level === "warn" ? ["warn", "error"] : ["info", "warn", "error"];
    const chosen = this.select.value;
    return this.state.log.filter((l) => wanted.includes(l.level) && (!chosen || (chosen.startsWith("=") ? l.who === chosen.slice(1) : l.stage === chosen)));
  }

  private draw(): void {
    this.redraw.done();
    const last = this.state.log.at(-1);
    this.last.textContent = last ? text(last) : "nothing yet";
    const count = (level: Level): number => this.state.log.filter((l) => l.level === level).length;
    this.levels[1].nextElementSibling!.textContent = `warnings ${count("warn") + count("error")}`;
    this.levels[2].nextElementSibling!.textContent = `errors ${count("error")}`;
    if (!this.element.open) return;
    const lines = this.shown();
    this.scrolling = true;
    refill(this.lines, `${lines.length} ${lines.at(-1)?.seq} ${lines[0]?.seq} ${this.select.value}`, () => lines.flatMap((l) => [
      h("span", { class: "q" }, clock(l.atMs, true)), " ", h("span", { class: `lv ${COLOUR[l.level]}` }, WORD[l.level]), h("span", { class: "wh" }, l.who), " ", `${l.text}\n`,
    ]));
    if (this.follow.getAttribute("aria-pressed") === "true") this.lines.scrollTop = this.lines.scrollHeight;
    requestAnimationFrame(() => (this.scrolling = false));
  }

  private setFollow(on: boolean): void {
    this.follow.setAttribute("aria-pressed", String(on));
    if (on) this.lines.scrollTop = this.lines.scrollHeight;
  }

  private save(): void {
    const lines = this.shown().map((l) => `${new Date(l.atMs).toISOString()} ${WORD[l.level].padEnd(5)} ${l.who.padEnd(18)} ${l.text}`);
    download(`${this.name}.log`, `${lines.join("\n")}\n`, "text/plain;charset=utf-8");
  }
}

function text(l: LogLine): string {
  return `${clock(l.atMs, true)} ${l.who}: ${l.text}`;
}
