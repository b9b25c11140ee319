/** The head of a job's page: what it is, its verdict or what keeps it open, and the ways out. */
import { listJobs, readJob } from "../api/client";
import type { JobDetail } from "../api/types";
import { cost as costText, count } from "../ui/format";
import { h, refill } from "./element";
import { historyOf, type Estimate, type History } from "./estimate";
import { ago, duration, metres, plural, sentences, shortId } from "./format";
import { jobMark, stateMark, verdictMark } from "./icons";
import { progressBar, timeLeftText } from "./job_row";
import type { Report } from "./report_types";

const HISTORIES = 3;

/** What the optimiser knows before the verdict: views that no candidate helps. */
export interface Heading {
  hopeless: number;
  views: number;
  smallestBudget: number | null;
  unit: string;
}

/** Seconds a stage of the last jobs that are done. */
export async function readHistories(except: string): Promise<History[]> {
  const { jobs } = await listJobs({ state: "done", limit: HISTORIES + 1 });
  const found: History[] = [];
  for (const job of jobs.filter((j) => j.id !== except).slice(0, HISTORIES)) found.push(historyOf((await readJob(job.id)).stages));
  return found;
}

export function drawHead(head: HTMLElement, job: JobDetail, report: Report | null, heading: Heading | null, found: Estimate, does: { cancel: () => void; retry: () => void }): void {
  if (!head.childElementCount) {
    head.className = "head";
    head.append(h("div"), h("div", { class: "acts" }), h("div", { class: "tobe" }, h("div"), h("p"), h("div")));
  }
  const [names, acts, banner] = head.children;
  const active = job.state === "queued" || job.state === "running";
  const age = ago(Date.parse(job.created_at), Date.now());
  refill(names, JSON.stringify([job.state, age, job.name]), () => [
    h("nav", { class: "crumb", "aria-label": "Path" }, h("a", { href: "/jobs" }, "Jobs"), " / ", h("span", { class: "mono" }, `job ${shortId(job.id)}`)),
    h("h1", null, job.name), facts(job, age)]);
  refill(acts, job.state, () => [
    job.links.viewer ? h("a", { class: "btn primary", href: job.links.viewer }, "Open in viewer") : null,
    job.links.report_page ? h("a", { class: "btn", href: job.links.report_page }, "Report") : null,
    job.state === "failed" || job.state === "cancelled" ? h("button", { class: "btn primary", type: "button", onclick: does.retry }, "Go on") : null,
    active ? null : h("a", { class: "btn", href: again(job.id) }, "Run again…"),
    job.state === "done" ? h("a", { class: "btn", href: `/compare#a=${encodeURIComponent(job.id)}` }, "Compare…") : null,
    active ? h("button", { class: "btn stop", type: "button", onclick: does.cancel }, "Cancel job…") : null]);
  const { kind, mark, text } = verdictOf(job, report, heading);
  banner.className = `tobe ${kind}`;
  refill(banner.children[0], JSON.stringify([job.state, job.verdict, kind]), () => [mark()]);
  refill(banner.children[1], JSON.stringify([job.state, job.verdict, !!report, heading]), text);
  refill(banner.children[2], JSON.stringify([job.state, job.started_at, job.finished_at, found]), () => progress(job, found));
  (banner as HTMLElement).setAttribute("role", "status");
}

function facts(job: JobDetail, age: string): HTMLElement {
  const { settings } = job;
  const fact = (name: string, value: string | null | undefined): HTMLElement | null => (value ? h("span", null, `${name} `, h("b", null, value)) : null);
  const camera = settings.camera?.width ? `${settings.camera.width} × ${settings.camera.height}, ${settings.camera.fov_deg}°` : null;
  return h("div", { class: "facts" }, jobMark(job.state), fact("budget", job.budget), fact("pixel error", settings.quality?.pixel_error ? `${settings.quality.pixel_error} px` : null),
    fact("cells", settings.view_space?.cell_m ? `${metres(settings.view_space.cell_m)} m` : "derived"), fact("camera", camera), fact("device", settings.device), h("span", null, age));
}

function again(id: string, budget?: string): string {
  return `/jobs#${new URLSearchParams({ again: id, ...(budget ? { budget } : {}) })}`;
}

interface Told {
  kind: string;
  mark: () => Node;
  text: () => (Node | string)[];
}

function verdictOf(job: JobDetail, report: Report | null, heading: Heading | null): Told {
  const b = (text: string): HTMLElement => h("b", null, text);
  if (job.state === "failed") {
    const { error } = job;
    const where = error?.stage ? `${error.stage} failed` : "failed";
    return { kind: "bad", mark: () => stateMark("bad", "fail", where), text: () => [b(sentences(error?.message ?? "The job failed")), " ", sentences(error?.advice, "What was computed before is kept")] };
  }
  if (job.state === "cancelled") return { kind: "", mark: () => stateMark("idle", "cancel", "Cancelled"), text: () => ["What was computed is kept: “Go on” continues from there."] };
  if (job.verdict === null && job.state === "running" && heading?.hopeless) {
    const { smallestBudget, unit } = heading;
    const way = smallestBudget === null ? null : unit === "ns" ? `${Math.ceil(smallestBudget / 1e4) / 100} ms` : `${smallestBudget} ${unit}`;
    return { kind: "inf", mark: () => stateMark("inf", "infeas", "Heading for infeasible"), text: () => [
      b(`${count(heading.hopeless)} of ${count(heading.views)}`), ` problem views cannot meet ${job.budget ?? "the budget"} with any impostor. The others look solvable. `,
      ...(way ? [h("a", { href: again(job.id, way) }, "Smallest budget that would work: ", b(way))] : [])] };
  }
  if (job.verdict === null) {
    const text = job.state === "queued" ? "The job waits for a worker." : "Whether every view can meet the budget is known once the placement has been evaluated.";
    return { kind: "", mark: () => stateMark("idle", "queue", "Verdict open"), text: () => [text] };
  }
  const budget = job.budget ?? "the budget";
  const kind = { valid: "ok", infeasible: "inf", unproven: "" }[job.verdict];
  return { kind, mark: () => verdictMark(job.verdict!), text: () => {
    if (!report) return [];
    if (job.verdict === "unproven") return ["The placement can be walked; it carries no certificate: its evaluation or its proof failed, or found a view over budget or an impostor unlike its geometry."];
    if (job.verdict === "infeasible") {
      const smallest = report.smallest_budget?.text;
      return [b(`${count(report.hopeless_views ?? 0)} of ${count(report.problem_views ?? 0)}`), ` problem views cannot meet ${budget} with any impostor. All other views do. `,
        ...(smallest ? [h("a", { href: again(job.id, smallest) }, "Smallest budget that works: ", b(smallest))] : [])];
    }
    if (report.problem_views === 0) {
      const heaviest = report.worst_geometry_cost !== undefined ? ` (heaviest: ${costText(report.worst_geometry_cost, report.unit ?? "")})` : "";
      return [`Valid without impostors: no view costs more than ${budget}${heaviest}.`];
    }
    return ["Every view is drawn within ", b(budget), report.problem_views !== undefined ? `, all ${plural(report.problem_views, "problem view")} with it.` : "."];
  } };
}

function progress(job: JobDetail, found: Estimate): Node[] {
  const began = Date.parse(job.started_at ?? job.created_at);
  const line = (a: string, c = ""): HTMLElement => h("div", { class: "eta" }, h("span", null, h("b", null, a)), h("span", null, c));
  if (job.state === "queued") return [progressBar("wait", 0, [], "Progress"), line("queued")];
  if (job.state === "running") {
    const left = timeLeftText(found);
    return [progressBar("", found.fraction, found.ends, "Progress"), line(`${Math.round(found.fraction * 100)} %`, left.main), h("small", { class: "q" }, left.small || "\u00a0")];
  }
  const took = job.finished_at ? `took ${duration((Date.parse(job.finished_at) - began) / 1000)}` : "";
  if (job.state === "done") return [line(took)];
  return [progressBar(job.state === "failed" ? "stop" : "off", job.progress, [], "Progress"), line(took.replace("took", "stopped after"))];
}
