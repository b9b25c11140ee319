/** /jobs/ID/report and /viewer/NAME/report: the certificate first, then what it rests on; every table as CSV. */
import { readJob, readReport } from "../api/client";
import type { JobDetail } from "../api/types";
import { h } from "./element";
import { failed, main, onKey, openPage, skeleton } from "./frame";
import { shortDigest, shortId } from "./format";
import { curvePanel } from "./curve";
import { histogramPanel } from "./histogram";
import { hopelessPanel } from "./hopeless";
import { certificate, deviceTable, figures, leftOut, notes, stagesTable, worstViews } from "./report_parts";
import { proofPanel } from "./proof";
import type { Report } from "./report_types";
import { count } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { download } from "../ui/csv";
import { readMap } from "./map_data";
import { ViewMap } from "./view_map";

const [kind, item] = location.pathname.split("/").filter(Boolean).map(decodeURIComponent);
await openPage([["V", "stand at the selected cell of the map"], ["+ -", "zoom the map"]]);
await start().catch((error: unknown) => failed(main, error, "This report cannot be shown", () => location.reload()));

async function start(): Promise<void> {
  const loading = skeleton(8);
  let job: JobDetail | null = null;
  let report: Report;
  try {
    if (kind === "jobs") job = await readJob(item);
    report = await readReport<Report>(kind === "jobs" ? { job: item } : { placement: item });
  } finally {
    loading.stop();
  }
  const title = [job?.name ?? item, report.budget].filter(Boolean).join(", ");
  document.title = `Report: ${title} · farfield`;
  const map = h("div");
  const byCost = h("div");
  const hopeless = h("div");
  const beside = (a: HTMLElement | null, b: HTMLElement | null): HTMLElement => h("div", { class: "two" }, a, b);
  main.replaceChildren(head(job, title, report), certificate(report, item), beside(stagesTable(report), figures(report)), beside(map, worstViews(report, item)), proofPanel(report, item) ?? "", curvePanel(report) ?? "", byCost, hopeless, deviceTable(report) ?? "", leftOut(report) ?? "", notes(report) ?? "");
  // The map needs the placement's own files; without them the report stands as it is.
  const data = await readMap(item, report).catch(() => null);
  const drawn = data && new ViewMap(data, item);
  if (data?.views) byCost.replaceChildren(histogramPanel(data.views) ?? "");
  if (drawn) {
    drawn.element.classList.add("report-part");
    map.replaceChildren(drawn.element);
    for (const key of ["v", "+", "=", "-"]) onKey(key, () => drawn.key(key));
  }
  const panel = hopelessPanel(report, item, (cell) => drawn?.select(cell));
  if (panel) hopeless.replaceChildren(panel);
}

function head(job: JobDetail | null, title: string, report: Report): HTMLElement {
  const way = job ? [h("a", { href: "/jobs" }, "Jobs"), " / ", h("a", { href: `/jobs/${encodeURIComponent(item)}`, class: "mono" }, `job ${shortId(item)}`), " / report"] : [h("a", { href: "/jobs" }, "Jobs"), " / ", h("span", { class: "mono" }, item), " / report"];
  const scene = job?.scene ?? report.inputs?.["scene"];
  const software = report.software?.["farfield"];
  const size = report.objects !== undefined ? `${count(report.objects)} objects, ${count(report.triangles ?? 0)} triangles` : null;
  return h("div", { class: "head" },
    h("div", null, h("nav", { class: "crumb", "aria-label": "Path" }, ...way), h("h1", null, title),
      h("div", { class: "facts" }, scene ? h("span", null, "scene ", h("b", { class: "mono" }, shortDigest(scene))) : null, size ? h("span", null, size) : null,
        typeof software === "string" ? h("span", null, "farfield ", h("b", null, software)) : null,
        job?.finished_at ? h("span", null, `${job.finished_at.slice(0, 16).replace("T", " ")} UTC`) : null)),
    h("div", { class: "acts" }, h("a", { class: "btn primary", href: viewAddress(item) }, "Open in viewer"),
      h("button", { type: "button", onclick: () => download(`${item}-report.json`, JSON.stringify(report, null, 1), "application/json") }, "JSON"),
      h("button", { type: "button", onclick: () => print() }, "Print")));
}
