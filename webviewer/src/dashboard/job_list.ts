/** The list of jobs: read in pages, kept fresh while anything runs, filtered in the address. */
import { cancelJob, explain, listJobs, readJob, Refused } from "../api/client";
import type { Job } from "../api/types";
import { h, refill } from "./element";
import { historyOf, Ratchet, type History } from "./estimate";
import { confirmed, failed, note, onKey, showLine } from "./frame";
import { COLUMNS, fillRow, makeRow, type RowData } from "./job_row";
import { rowWindow } from "./row_window";

const BUSY_MS = 1500;
const IDLE_MS = 10_000;
const PAGE = 100;
const WATCHED = 4; // running jobs whose stages are read for their time left
const HISTORIES = 3;
const HEADINGS = { state: "State", scene: "Scene", bud: "Budget", prog: "Progress, time left", ver: "Verdict", mem: "Memory", age: "Age" };

type StateFilter = "all" | "active" | "done" | "failed";
const STATES: Record<StateFilter, (job: Job) => boolean> = {
  all: () => true,
  active: (j) => j.state === "queued" || j.state === "running",
  done: (j) => j.state === "done",
  failed: (j) => j.state === "failed" || j.state === "cancelled",
};

const ROW_PX = 58;

function spacer(): HTMLTableRowElement {
  return h("tr", { class: "spacer", "aria-hidden": "true" }, h("td", { colspan: COLUMNS.length }));
}

export class JobList {
  readonly element: HTMLElement;
  private readonly rows = new Map<string, { row: HTMLTableRowElement | null; data: RowData }>();
  private shownNow: string[] = [];
  private readonly above = spacer();
  private readonly beneath = spacer();
  private reading: Promise<void> | null = null;
  private order: string[] = [];
  private cursor: string | null = null;
  private readonly histories: History[] = [];
  private readonly ratchet = new Ratchet();
  private readonly body = h("tbody");
  private readonly table: HTMLTableElement;
  private readonly below = h("div", { class: "empty" });
  private readonly says = h("div", { role: "status" });
  private readonly count = h("span", { class: "end" });
  private readonly search = h("input", { type: "search", "aria-label": "Filter jobs by scene or digest", placeholder: "scene, digest   /" });
  private readonly radios: Record<string, { input: HTMLInputElement; text: HTMLElement }> = {};
  private timer: ReturnType<typeof setTimeout> | undefined;
  private lostAtMs = 0;
  private loaded = false;

  constructor() {
    const seg = h("div", { class: "seg", role: "radiogroup", "aria-label": "State" });
    for (const [value, word] of Object.entries({ all: "All", active: "Active", done: "Done", failed: "Failed" })) {
      const input = h("input", { type: "radio", name: "state", value, onchange: () => this.filterChanged() });
      const text = h("span", null, word);
      this.radios[value] = { input, text };
      seg.append(h("label", null, input, text));
    }
    this.table = h("table", { class: "jt" }, h("caption", { class: "sr" }, "Jobs, newest first"),
      h("colgroup", null, ...COLUMNS.map((c) => h("col", { class: `w-${c}` }))),
      h("thead", null, h("tr", null, ...COLUMNS.map((c) => h("th", c === "bud" || c === "mem" ? { class: "r", scope: "col" } : { scope: "col" }, HEADINGS[c])))), this.body);
    const form = h("form", { class: "filter", role: "search", onsubmit: (e: Event) => e.preventDefault() }, this.search, seg, this.count);
    this.search.addEventListener("input", () => this.filterChanged());
    this.element = h("div", null, h("h1", { class: "sr" }, "Jobs"), form, this.says, this.table, this.below);
    this.readAddress();
    addEventListener("hashchange", () => this.readAddress());
    onKey("/", (e) => (e.preventDefault(), this.search.focus()));
    onKey("ArrowDown", (e) => this.step(e, 1));
    onKey("ArrowUp", (e) => this.step(e, -1));
    onKey("Escape", () => document.activeElement === this.search && this.clear());
    let drawing = 0;
    const soon = (): void => void (drawing ||= requestAnimationFrame(() => ((drawing = 0), this.drawRows())));
    addEventListener("scroll", soon, { passive: true });
    addEventListener("resize", soon);
    document.addEventListener("visibilitychange", () => !document.hidden && void this.refresh());
  }

  /** Reads the newest page now, and again from time to time; resolves once it is drawn. */
  refresh(): Promise<void> {
    clearTimeout(this.timer);
    return this.read().finally(() => {
      clearTimeout(this.timer);
      const busy = [...this.rows.values()].some((r) => STATES.active(r.data.job));
      this.timer = setTimeout(() => (document.hidden ? (this.timer = undefined) : void this.refresh()), busy || this.lostAtMs ? BUSY_MS : IDLE_MS);
    });
  }

  private async read(): Promise<void> {
    try {
      const page = await listJobs({ limit: PAGE });
      const known = new Set(this.order);
      const fresh = page.jobs.map((j) => j.id);
      // What lies beyond the first page stays as it was read; a page never loses a row that it showed.
      const newest = new Set(fresh);
      this.order = [...fresh, ...this.order.filter((id) => !newest.has(id))];
      if (!this.loaded || !known.size) this.cursor = page.next;
      for (const job of page.jobs) this.put(job);
      await this.readMore();
      this.loaded = true;
      this.lostAtMs = 0;
      showLine(true);
      this.says.replaceChildren();
      this.draw();
    } catch (error) {
      if (error instanceof Refused && error.status === 401) location.reload(); // the session is over: sign in again
      this.lostAtMs ||= Date.now();
      this.says.className = this.loaded ? "toast" : "";
      showLine(false, this.lostAtMs);
      if (!this.loaded) failed(this.says, error, "The jobs cannot be read", () => void this.refresh());
      else {
        const told = `Not live: ${explain(error).text}`;
        refill(this.says, told, () => [note("inf", "infeas", told, `What you see was read before. Trying again every ${BUSY_MS / 1000} s; nothing is lost.`)]);
      }
    }
  }

  private put(job: Job): void {
    const held = this.rows.get(job.id);
    if (held) held.data.job = job;
    else this.rows.set(job.id, { row: null, data: { job, detail: null } });
  }

  /** Stages of what runs. */
  private async readMore(): Promise<void> {
    const jobs = this.order.map((id) => this.rows.get(id)!.data);
    const running = jobs.filter((d) => d.job.state === "running").slice(0, WATCHED);
    if (running.length && !this.histories.length) {
      const done = jobs.filter((d) => d.job.state === "done").slice(0, HISTORIES);
      for (const d of done) this.histories.push(historyOf((await readJob(d.job.id)).stages));
    }
    for (const d of running) d.detail = await readJob(d.job.id);
  }

  private rowOf(id: string): HTMLTableRowElement {
    const held = this.rows.get(id)!;
    held.row ??= makeRow();
    fillRow(held.row, held.data, this.histories, this.ratchet, (job) => void this.cancel(job));
    return held.row;
  }

  /** Puts the rows in sight into the table, and a little more; spacers stand for the rest. */
  private drawRows(): void {
    const n = this.shownNow.length;
    const real = [...this.body.rows].find((row) => !row.hasAttribute("aria-hidden"));
    const height = Math.max(20, real?.getBoundingClientRect().height ?? ROW_PX);
    const top = this.body.getBoundingClientRect().top;
    const focused = this.shownNow.findIndex((id) => this.rows.get(id)!.row?.contains(document.activeElement));
    const { first, last } = rowWindow(n, height, -top, innerHeight, n === 0 ? -1 : focused);
    const rows: HTMLTableRowElement[] = this.shownNow.slice(first, last).map((id) => this.rowOf(id));
    if (first > 0) rows.unshift(this.above);
    if (last < n) rows.push(this.beneath);
    (this.above.firstElementChild as HTMLElement).style.setProperty("height", `${first * height}px`);
    (this.beneath.firstElementChild as HTMLElement).style.setProperty("height", `${(n - last) * height}px`);
    const wanted = new Set(rows);
    for (const row of [...this.body.rows]) if (!wanted.has(row)) row.remove();
    rows.forEach((row, k) => this.body.rows[k] !== row && this.body.insertBefore(row, this.body.rows[k] ?? null));
    this.table.setAttribute("aria-rowcount", String(this.cursor ? -1 : n + 1));
    const all = this.filter();
    if (this.cursor && last === n && top + n * height < 2 * innerHeight && scrollY > 0 && all.state === "all" && !all.words.length) void this.older();
  }

  private shown(): string[] {
    const { words, state } = this.filter();
    return this.order.filter((id) => {
      const { job } = this.rows.get(id)!.data;
      const text = `${job.name} ${job.scene} ${job.id} ${job.budget} ${job.state} ${job.verdict ?? ""}`.toLowerCase();
      return STATES[state](job) && words.every((w) => text.includes(w));
    });
  }

  private draw(): void {
    const shown = (this.shownNow = this.shown());
    this.drawRows();
    const jobs = this.order.map((id) => this.rows.get(id)!.data.job);
    const active = jobs.filter(STATES.active).length;
    const broken = jobs.filter((j) => j.state === "failed").length;
    this.radios.active.text.textContent = active ? `Active ${active}` : "Active";
    this.radios.failed.text.textContent = broken ? `Failed ${broken}` : "Failed";
    this.table.hidden = !shown.length;
    const total = `${jobs.length.toLocaleString("en")}${this.cursor ? " or more" : ""}`;
    this.count.textContent = shown.length === jobs.length ? total : `${shown.length.toLocaleString("en")} of ${total}`;
    refill(this.below, JSON.stringify([jobs.length > 0, shown.length > 0, this.search.value, this.cursor]), () => this.underneath(jobs.length, shown.length));
  }

  private underneath(all: number, shown: number): (Node | null)[] {
    if (!all) {
      return [h("section", { class: "panel" }, h("header", null, h("h2", null, "No jobs yet")),
        h("p", { class: "q2" }, "Drop a level on this page, or send one from a build:"),
        h("pre", { class: "mono" }, `farfield submit level.glb --url ${location.origin} --budget "16 ms"`))];
    }
    const more = this.cursor ? h("div", { class: "more" }, h("button", { type: "button", onclick: () => void this.older() }, "Older jobs")) : null;
    if (shown) return [more];
    const sought = this.filter().words.join(" ");
    return [h("section", { class: "panel" }, h("header", null, h("h2", null, "Nothing matches the filter")),
      h("p", { class: "q2" }, sought ? `No job of this kind matches “${sought}”.` : "No job is in this state."),
      h("div", { class: "more" }, h("button", { type: "button", onclick: () => this.clear() }, "Clear filter"))), more];
  }

  private older(): Promise<void> {
    this.reading ??= this.readOlder().finally(() => (this.reading = null));
    return this.reading;
  }

  private async readOlder(): Promise<void> {
    if (!this.cursor) return;
    try {
      const page = await listJobs({ limit: PAGE, cursor: this.cursor });
      this.cursor = page.next;
      for (const job of page.jobs) {
        if (!this.rows.has(job.id)) this.order.push(job.id);
        this.put(job);
      }
      this.draw();
    } catch (error) {
      failed(this.says, error, "Older jobs cannot be read");
    }
  }

  private async cancel(job: Job): Promise<void> {
    const yes = await confirmed(`Cancel ${job.name}?`, "What is computed so far is kept, and a new job with the same scene and settings starts from there.", "Cancel the job", "Let it run");
    if (!yes) return;
    await cancelJob(job.id).catch((error: unknown) => failed(this.says, error, "The job could not be cancelled"));
    void this.refresh();
  }

  private filter(): { words: string[]; state: StateFilter } {
    const state = (Object.entries(this.radios).find(([, r]) => r.input.checked)?.[0] ?? "all") as StateFilter;
    return { words: this.search.value.toLowerCase().split(/\s+/).filter(Boolean), state };
  }

  private clear(): void {
    this.search.value = "";
    this.radios.all.input.checked = true;
    this.filterChanged();
    this.search.focus();
  }

  /** The filter stands in the fragment: it can be sent on, and no server log has it. */
  private filterChanged(): void {
    const { state } = this.filter();
    const parts = new URLSearchParams();
    if (this.search.value) parts.set("find", this.search.value);
    if (state !== "all") parts.set("state", state);
    history.replaceState(null, "", parts.size ? `#${parts}` : location.pathname);
    this.draw();
  }

  private readAddress(): void {
    const given = new URLSearchParams(location.hash.slice(1));
    this.search.value = given.get("find") ?? "";
    (this.radios[given.get("state") ?? "all"] ?? this.radios.all).input.checked = true;
    if (this.loaded) this.draw();
  }

  private step(event: KeyboardEvent, by: number): void {
    if (event.target instanceof HTMLInputElement && event.target.type === "radio") return; // arrows choose there
    if (!this.shownNow.length) return;
    const at = this.shownNow.findIndex((id) => this.rows.get(id)!.row?.contains(document.activeElement));
    const next = Math.max(0, Math.min(this.shownNow.length - 1, at < 0 ? 0 : at + by));
    const row = this.rowOf(this.shownNow[next]);
    if (!row.isConnected) scrollTo({ top: 0 }), this.drawRows(); // only the first may be out of the window
    row.querySelector<HTMLAnchorElement>(".scene a")?.focus();
    event.preventDefault();
  }
}
