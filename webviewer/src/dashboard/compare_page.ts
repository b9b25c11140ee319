/** /compare#a=JOB&b=JOB: two jobs side by side: settings that differ, figures, curves over each other, stages. */
import { listJobs, readJob, readReport } from "../api/client";
import type { Job, JobDetail } from "../api/types";
import { cost as costText } from "../ui/format";
import { change, differences, figuresOf, type Figure } from "./compare_facts";
import { curvePlot } from "./curve";
import { h, scroller } from "./element";
import { failed, main, openPage, skeleton } from "./frame";
import { duration, shortId } from "./format";
import { verdictMark } from "./icons";
import { csvButton, part } from "./report_parts";
import type { Report } from "./report_types";

interface Side {
  job: JobDetail;
  report: Report;
}

await openPage([["Tab", "first job, second job"]]);
const body = h("div");
const picks = h("form", { class: "picks", "aria-label": "Jobs to compare", onsubmit: (e: Event) => e.preventDefault() });
main.replaceChildren(h("div", { class: "head" }, h("div", null, h("nav", { class: "crumb", "aria-label": "Path" }, h("a", { href: "/jobs" }, "Jobs"), " / compare"), h("h1", null, "Compare two jobs"))), picks, body);
let turn = 0;
await listJobs({ state: "done", limit: 100 }).then(({ jobs }) => start(jobs), (error: unknown) => failed(body, error, "The jobs cannot be read", () => location.reload()));

async function start(jobs: Job[]): Promise<void> {
  const given = new URLSearchParams(location.hash.slice(1));
  if (jobs.length < 2 && !(given.has("a") && given.has("b"))) {
    body.replaceChildren(h("section", { class: "panel" }, h("header", null, h("h2", null, "Two finished jobs are needed")),
      h("p", { class: "q2" }, "Run a level twice, say at two budgets: ", h("a", { href: "/jobs" }, "to the jobs"), ".")));
    return;
  }
  const selects = [["a", "First"], ["b", "Second"]].map(([key, word]) => {
    const wanted = given.get(key);
    const select = h("select", { id: `pick-${key}`, onchange: () => void choose() }, h("option", { value: "" }, "choose a job"),
      wanted && !jobs.some((j) => j.id === wanted) ? h("option", { value: wanted }, `job ${shortId(wanted)}`) : null,
      ...jobs.map((j) => h("option", { value: j.id }, `${j.name}, ${j.budget}, ${shortId(j.id)}`)));
    if (wanted) select.value = wanted;
    picks.append(h("label", { for: select.id }, word), select);
    return select;
  });
  const choose = async (): Promise<void> => {
    const [a, b] = selects.map((select) => select.value);
    history.replaceState(null, "", `#${new URLSearchParams({ ...(a ? { a } : {}), ...(b ? { b } : {}) })}`);
    const mine = ++turn;
    if (!a || !b) return body.replaceChildren(h("p", { class: "q2" }, "Choose two jobs: the address then names them, and can be sent on."));
    body.replaceChildren();
    const loading = skeleton(6, body);
    try {
      const sides = await Promise.all([a, b].map(async (id): Promise<Side> => ({ job: await readJob(id), report: await readReport<Report>({ job: id }) })));
      loading.stop();
      if (mine === turn) body.replaceChildren(...panels(sides[0], sides[1]));
    } catch (error) {
      loading.stop();
      if (mine === turn) failed(body, error, "These jobs cannot be compared", () => void choose());
    }
  };
  await choose();
}

function panels(a: Side, b: Side): Node[] {
  const names = a.job.name === b.job.name ? [`A: ${a.job.budget}`, `B: ${b.job.budget}`] : [`A: ${a.job.name}`, `B: ${b.job.name}`];
  const differ = differences(a.job.settings, b.job.settings);
  const head = (first: string, ...more: string[]): HTMLElement => h("thead", null, h("tr", null, h("th", { scope: "col" }, first), ...[...names, ...more].map((n) => h("th", { scope: "col", class: "r" }, n))));
  const settings = differ.length
    ? h("table", { class: "num" }, h("caption", { class: "sr" }, "Settings that differ"), head("Setting"), h("tbody", null, ...differ.map((d) => h("tr", null, h("th", { scope: "row", class: "mono" }, d.key), h("td", { class: "r wrap" }, d.a), h("td", { class: "r wrap" }, d.b)))))
    : h("p", { class: "q2" }, a.job.scene === b.job.scene ? "None: the same level with the same settings, so the placements are the same." : "None: the levels differ.");
  const figures = figuresOf(a.report, b.report);
  const verdicts = h("tr", null, h("th", { scope: "row" }, "Verdict"), ...[a, b].map((side) => h("td", { class: "r" }, side.report.verdict ? verdictMark(side.report.verdict) : "—")), h("td", null));
  const links = h("tr", null, h("th", { scope: "row" }, "More"), ...[a, b].map(({ job }) => h("td", { class: "r" }, h("a", { href: `/jobs/${job.id}` }, "job"), ", ", h("a", { href: `/jobs/${job.id}/report` }, "report"), ", ", h("a", { href: `/viewer/${job.id}` }, "viewer"))), h("td", null));
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Figures side by side; the better one is bold"), head("Figure", "Change"), h("tbody", null, verdicts, ...figures.map(row), links));
  const made: (HTMLElement | null)[] = [
    part("df-h", "Settings that differ", a.job.scene === b.job.scene ? "" : "the levels differ, too", csvButton("settings", ["setting", "a", "b"], () => differ.map((d) => [d.key, d.a, d.b])), scroller(settings)),
    part("fg-h", "Figures", "the better one is bold", csvButton("comparison", ["figure", "a", "b"], () => figures.map((f) => [f.name, f.a, f.b])), scroller(table)),
    curves(a, b, names), stages(a, b, names),
  ];
  return made.filter((panel) => panel !== null);
}

function row(f: Figure): HTMLElement {
  const better = f.less !== null && f.a !== null && f.b !== null && f.a !== f.b ? (f.a < f.b) === f.less : null;
  const cell = (n: number | null, wins: boolean): HTMLElement => h("td", { class: "r nw" }, n === null ? "—" : wins ? h("b", null, f.text(n)) : f.text(n));
  return h("tr", null, h("th", { scope: "row" }, f.name), cell(f.a, better === true), cell(f.b, better === false), h("td", { class: "r nw q" }, change(f)));
}

function curves(a: Side, b: Side, names: string[]): HTMLElement | null {
  const [left, right] = [a, b].map(({ report }) => (report.curve ?? []).filter((p) => p.budget > 0));
  if (!left.length || !right.length) return null;
  const unit = a.report.unit ?? "";
  if (unit !== b.report.unit) return part("cc-h", "Memory over budget", "", null, h("p", { class: "q2" }, "The budgets are in different units, so their curves have no common axis."));
  const label = `Memory over budget: ${names[0]} from ${costText(left[0].budget, unit)}, ${names[1]} from ${costText(right[0].budget, unit)}`;
  return part("cc-h", "Memory over budget", "", csvButton("curves", ["job", `budget_${unit}`, "bytes", "views_over"], () => [...left.map((p) => ["a", p.budget, p.bytes, p.views_over]), ...right.map((p) => ["b", p.budget, p.bytes, p.views_over])]),
    h("div", { class: "curve wide" }, curvePlot([{ name: names[0], kind: "one", points: left }, { name: names[1], kind: "two", points: right }], unit, label)),
    h("p", { class: "key" }, h("span", null, h("i", { class: "swatch one" }), names[0]), h("span", null, h("i", { class: "swatch two" }), names[1])));
}

function stages(a: Side, b: Side, names: string[]): HTMLElement {
  const seconds = [a, b].map(({ report }) => new Map(report.stages.map((s) => [s.name, s.seconds])));
  const order = [...new Set([...seconds[0].keys(), ...seconds[1].keys()])];
  const longest = Math.max(1e-9, ...seconds.flatMap((m) => [...m.values()]));
  const bar = (value: number, kind: string): HTMLElement => h("i", { class: `prop ${kind}${value > 0 ? "" : " off"}`, css: { "--at": `${(100 * value) / longest}%` } });
  const rows = order.map((name) => {
    const [x, y] = seconds.map((m) => m.get(name) ?? 0);
    return h("tr", null, h("th", { scope: "row" }, name), h("td", { class: "r nw" }, duration(x)), h("td", { class: "r nw" }, duration(y)), h("td", { class: "st-bar" }, bar(x, "one"), bar(y, "two")));
  });
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Seconds of each stage"), h("thead", null, h("tr", null, h("th", { scope: "col" }, "Stage"), ...names.map((n) => h("th", { scope: "col", class: "r" }, n)), h("th", null, h("span", { class: "sr" }, "As bars")))), h("tbody", null, ...rows));
  return part("sg-h", "Stages", "what was taken over from an earlier job takes no time", csvButton("stages-compared", ["stage", "a_seconds", "b_seconds"], () => order.map((name) => [name, seconds[0].get(name), seconds[1].get(name)])), scroller(table));
}
