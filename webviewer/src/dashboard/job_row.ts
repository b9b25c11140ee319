/** One job as a row of the list. Cells are set anew only where what they show has changed. */
import type { Job, JobDetail } from "../api/types";
import { bytes } from "../ui/format";
import { h, refill } from "./element";
import { estimate, type Estimate, type History, type Ratchet } from "./estimate";
import { ago, duration, plural, shortDigest, timeRange } from "./format";
import { jobMark, stateMark, verdictMark } from "./icons";

export const COLUMNS = ["state", "scene", "bud", "prog", "ver", "mem", "age"] as const;

export interface RowData {
  job: Job;
  detail: JobDetail | null; // of a job that runs
}

export function makeRow(): HTMLTableRowElement {
  return h("tr", null, ...COLUMNS.map((c) => h("td", { class: `c-${c}${c === "bud" || c === "mem" ? " r" : ""}` })));
}

export function fillRow(row: HTMLTableRowElement, data: RowData, histories: readonly History[], ratchet: Ratchet, cancel: (job: Job) => void): void {
  const { job, detail } = data;
  const [state, scene, budget, progress, verdict, memory, age] = row.cells;
  const old = ago(Date.parse(job.created_at), Date.now());
  const active = job.state === "queued" || job.state === "running";
  budget.dataset.l = "budget";
  memory.dataset.l = "memory";
  refill(state, job.state, () => [jobMark(job.state)]);
  refill(scene, job.name + job.id, () => [
    h("div", { class: "scene" }, h("a", { href: job.links.page, title: job.name }, job.name), h("br"), h("small", { class: "mono q" }, shortDigest(job.scene))),
  ]);
  refill(budget, job.budget ?? "", () => [h("span", { class: "nw" }, job.budget)]);
  const found = active && detail ? estimate(detail.stages, histories) : null;
  refill(progress, JSON.stringify([job.state, job.progress, job.stage, job.finished_at, found]), () => progressOf(job, found, ratchet));
  refill(verdict, JSON.stringify([job.state, job.verdict]), () => verdictOf(job));
  refill(memory, JSON.stringify(job.bytes), () => (job.bytes === null ? [h("span", { class: "q" }, "—")] : [bytes(job.bytes)]));
  refill(age, old + active, () => [
    h("time", { datetime: job.created_at, title: new Date(job.created_at).toLocaleString(), class: "nw" }, old),
    active ? h("div", null, h("button", { class: "btn plain act", type: "button", "aria-label": `Cancel ${job.name}`, onclick: () => cancel(job) }, "Cancel…")) : null,
  ]);
}

/** A bar whose ticks are stage ends. */
export function progressBar(kind: string, fraction: number, ends: readonly number[], label: string): HTMLElement {
  const percent = Math.round(fraction * 100);
  return h("div", { class: `bar ${kind}`, role: "progressbar", "aria-valuenow": percent, "aria-valuemin": 0, "aria-valuemax": 100, "aria-label": label },
    h("i", { css: { "--at": `${fraction * 100}%` } }),
    ...ends.filter((e) => e < fraction + 1e-9 && e < 1).map((e) => h("b", { css: { "--at": `${e * 100}%` } })));
}

/** "8 to 13 min left", or what keeps it from being known. */
export function timeLeftText(found: Estimate): { main: string; small: string } {
  if (!found.left) return { main: "not known yet", small: found.basis };
  const range = timeRange(found.left.low, found.left.high);
  if (!found.left.later) return { main: `${range} left`, small: found.basis };
  return { main: `${range} left in this stage`, small: [found.basis, `${plural(found.left.later, "stage")} after it not known yet`].filter(Boolean).join("; ") };
}

function progressOf(job: Job, found: Estimate | null, ratchet: Ratchet): (Node | null)[] {
  const began = Date.parse(job.started_at ?? job.created_at);
  const took = job.finished_at ? (Date.parse(job.finished_at) - began) / 1000 : 0;
  if (job.state === "done") return [line(`took ${duration(took)}`)];
  if (job.state === "failed" || job.state === "cancelled") {
    const where = [job.error?.stage, job.error?.code].filter(Boolean).join(": ");
    const kind = job.state === "failed" ? "stop" : "off";
    const word = job.state === "failed" ? "stopped" : "cancelled";
    return [progressBar(kind, job.progress, [], job.name), line(`${word} after ${duration(took)}`), where ? h("small", { class: "q", title: job.error?.message }, where) : null];
  }
  if (job.state === "queued") return [progressBar("wait", 0, [], job.name), line("waits for a worker")];
  const fraction = ratchet.at(job.id, found?.fraction ?? job.progress);
  const left = found ? timeLeftText(found) : { main: job.stage ?? "", small: "" };
  return [progressBar("", fraction, found?.ends ?? [], job.name), line(`${Math.round(fraction * 100)} % · ${left.main}`), left.small ? h("small", { class: "q", title: left.small }, left.small) : null];
}

function line(text: string): HTMLElement {
  return h("div", { class: "eta" }, h("span", null, text));
}

function verdictOf(job: Job): (Node | null)[] {
  if (job.verdict) {
    const why = job.verdict === "infeasible" && job.hopeless_views !== null ? `${plural(job.hopeless_views, "view")}; ${job.smallest_budget} works` : "";
    return [verdictMark(job.verdict), why ? h("small", { class: "q", title: why }, why) : null];
  }
  if (job.state === "failed") return [stateMark("bad", "fail", "none")];
  if (job.state === "cancelled") return [stateMark("idle", "cancel", "none")];
  return [stateMark("idle", "queue", "open")];
}
