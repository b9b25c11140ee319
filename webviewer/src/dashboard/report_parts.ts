/** The parts of a report; each is left out where the report has nothing for it. */
import { bearing, bytes, cost as costText, count } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { csv, download, type Cell } from "../ui/csv";
import { h, s, scroller } from "./element";
import { duration, plural } from "./format";
import { compass } from "./hopeless";
import { icon, verdictMark } from "./icons";
import type { Report } from "./report_types";

type Row = [name: string, value: string, hint: string];

function known<T>(value: T | null | undefined): value is T {
  return value !== null && value !== undefined;
}

export function certificate(report: Report, placement: string): HTMLElement {
  const unit = report.unit ?? "";
  const checked: (Row | null)[] = [];
  const rest: (Row | null)[] = [];
  const { verified } = report;
  if (known(report.budget)) checked.push(["Budget of a frame", report.budget, ""]);
  if (known(report.worst_cost_bound)) checked.push(["Worst view, bound as placed", costText(report.worst_cost_bound, unit), report.hopeless_views ? "hopeless views included" : ""]);
  if (known(report.worst_geometry_cost)) checked.push(["Worst view, plain geometry", costText(report.worst_geometry_cost, unit), ""]);
  if (verified) {
    checked.push(["Random views verified", count(verified.views), known(verified.in_problem_views) ? `${count(verified.in_problem_views)} in problem views` : ""]);
    checked.push(["Of these over budget", count(verified.over_budget), "outside hopeless views"]);
    checked.push(["Worst of these", `${(100 * verified.worst_ratio).toFixed(1)} %`, "of the budget"]);
  }
  if (known(report.hopeless_views)) rest.push(["Hopeless views", count(report.hopeless_views), known(report.problem_views) ? `of ${count(report.problem_views)}` : ""]);
  if (report.smallest_budget && report.hopeless_views) rest.push(["Smallest feasible budget", report.smallest_budget.text, "with these candidates"]);
  if (known(report.bytes)) rest.push(["Impostor memory", bytes(report.bytes), known(report.impostors) ? plural(report.impostors, "impostor") : ""]);
  const seen = report.visibility;
  if (seen && seen.mode !== "off") {
    const missed = known(seen.missed_ppm_upper) ? `at most ${seen.missed_ppm_upper.toFixed(0)} missed pixels a million (95 %)${known(seen.p99_ppm) ? `, ${seen.p99_ppm.toFixed(0)} in the worst view of 100` : ""}` : "no camera point to test it from";
    rest.push(["Objects a cell sees", seen.mean_objects.toFixed(0), `${seen.mode}; ${missed}${seen.closed_cells ? `; ${seen.closed_cells} cells closed` : ""}${(seen.occluders ?? []).map((why) => `; ${why}`).join("")}`]);
  }
  if (report.bound && known(report.lower_bound_bytes)) rest.push(["Proven lower bound", bytes(report.lower_bound_bytes), `before the bake; ${bytes(report.bound.estimated_bytes)} placed${known(report.bound.gap) ? `, ${(100 * report.bound.gap).toFixed(0)} % more` : ""}`]);
  if (known(report.file_bytes)) rest.push(["Files", bytes(report.file_bytes), known(report.pages) ? plural(report.pages, "page") : ""]);
  if (known(report.video_bytes)) rest.push(["Video memory, all pages", bytes(report.video_bytes), ""]);
  if (verified?.resident) rest.push(["Resident at once, worst cell", bytes(verified.resident.bytes), `cell ${verified.resident.cell}; median ${bytes(verified.resident.median_bytes)}, all of it ${bytes(verified.resident.all_bytes)}`]);
  const worst = verified?.worst_view;
  return h("section", { class: "cert", "aria-label": "Certificate" },
    h("div", null, h("div", { class: "big" }, verdictMark(report.verdict)), ...meaning(report),
      worst ? h("p", { class: "small noprint" }, h("a", { href: viewAddress(placement, worst.position, worst.direction) }, "Stand at the worst verified view")) : null),
    facts(checked), facts(rest));
}

function facts(rows: (Row | null)[]): HTMLElement {
  return h("table", null, h("tbody", null, ...rows.filter(known).map(([name, value, hint]) => h("tr", null, h("td", null, name), h("td", { class: "v" }, value), h("td", { class: "h" }, hint)))));
}

function meaning(report: Report): HTMLElement[] {
  const b = (text: string): HTMLElement => h("b", null, text);
  const budget = report.budget ?? "the budget";
  const camera = report.camera ? `Holds for ${report.camera.width} × ${report.camera.height}, ${report.camera.fov_deg}° vertical, no roll` : "";
  const device = report.settings?.device ? `, device ${report.settings.device}` : "";
  const error = report.quality ? [" at a parallax of at most ", b(`${report.quality.pixel_error} px`)] : [];
  const lines: HTMLElement[] = [];
  if (report.verdict === "valid") {
    lines.push(h("p", null, "Every view in the view space is drawn within ", b(budget), ...(report.impostors ? error : []), "."));
    if (report.problem_views === 0) lines.push(h("p", null, "No view costs more as plain geometry: there was nothing to place."));
  } else if (report.verdict === "infeasible") {
    lines.push(h("p", null, b(plural(report.hopeless_views ?? 0, "view")), " cannot meet ", b(budget), " with any impostor. Every other view does", ...error, "."));
  } else {
    lines.push(h("p", null, "It is not proved that every view meets ", b(budget), ". The placement can be walked; it carries no certificate."));
  }
  if (report.stopped) lines.push(h("p", { class: "small" }, "Optimising was stopped by its time limit: more time could save memory."));
  if (camera) lines.push(h("p", { class: "small q" }, `${camera}${device}.`));
  return lines;
}

export function csvButton(name: string, header: string[], rows: () => Cell[][]): HTMLElement {
  return h("button", { class: "btn plain noprint", type: "button", "aria-label": `${name} as CSV`, onclick: () => download(`${name}.csv`, csv(header, rows())) }, "CSV");
}

export function part(id: string, title: string, hint: string, button: HTMLElement | null, ...content: Node[]): HTMLElement {
  return h("section", { class: "panel report-part", "aria-labelledby": id }, h("header", null, h("h2", { id }, title), hint ? h("span", { class: "small q" }, hint) : null, h("div", { class: "end" }, button)), ...content);
}

export function figures(report: Report): HTMLElement | null {
  const rows: [string, string, number | null | undefined, "count" | "bytes"][] = [
    ["Objects", "what a placement may replace", report.objects, "count"],
    ["Triangles", "", report.triangles, "count"],
    ["Coarser levels", report.detail ? `spare ${Math.round(100 * report.detail.spared)} % of the triangles` : "", report.detail?.levels, "count"],
    ["Level bytes", "indices of the coarser levels", report.detail?.bytes, "bytes"],
    ["View-space cells", "leaves of the view-space tree", report.cells, "count"],
    ["Problem views", "cell and direction over budget as geometry", report.problem_views, "count"],
    ["Hopeless views", "over budget with any impostor", report.hopeless_views, "count"],
    ["Candidates", "impostors that were weighed", report.candidates, "count"],
    ["Impostors", "chosen and baked", report.impostors, "count"],
    ["Layers", "quads that stand for them", report.layers, "count"],
    ["Impostor bytes", "the measure that was made least", report.bytes, "bytes"],
    ["File bytes", "index, chunks and pages", report.file_bytes, "bytes"],
    ["Video bytes", "all pages in video memory", report.video_bytes, "bytes"],
    ["Resident bytes, worst cell", "chunk, pages and level of all its views", report.verified?.resident?.bytes, "bytes"],
    ["Resident bytes, median cell", "", report.verified?.resident?.median_bytes, "bytes"],
    ["Chunks", "files of problem views", report.chunks, "count"],
    ["Pages", "texture atlases", report.pages, "count"],
  ];
  const there = rows.filter(([, , value]) => known(value));
  if (!there.length) return null;
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Figures"), h("tbody", null, ...there.map(([name, hint, value, kind]) =>
    h("tr", null, h("th", { scope: "row" }, name, hint ? h("small", { class: "q" }, hint) : null), h("td", { class: "r nw" }, kind === "bytes" ? bytes(value!) : count(value!))))));
  return part("fig-h", "Figures", "", csvButton("figures", ["figure", "value"], () => there.map(([name, , value]) => [name, value!])), scroller(table));
}

export function stagesTable(report: Report): HTMLElement | null {
  if (!report.stages.length) return null;
  const longest = Math.max(...report.stages.map((stage) => stage.seconds), 1e-9);
  const largest = Math.max(...report.stages.map((stage) => stage.peak_bytes ?? 0), 1);
  const bar = (share: number): SVGElement => s("svg", { class: "sbar", viewBox: "0 0 100 8", preserveAspectRatio: "none", "aria-hidden": "true" }, s("rect", { width: share > 0 ? Math.max(0.5, 100 * share) : 0, height: 8 }));
  const memory = report.stages.some((stage) => known(stage.peak_bytes));
  const rows = report.stages.map((stage) => stage.skipped !== null && stage.skipped !== undefined
    ? h("tr", { class: "skipd" }, h("th", { scope: "row" }, icon("skip"), ` ${stage.name}`), h("td", { class: "r nw" }, stage.seconds > 0 ? duration(stage.seconds) : "skipped"), h("td", { class: "st-why", colspan: memory ? 3 : 1 }, stage.skipped))
    : h("tr", null, h("th", { scope: "row" }, stage.name, ...(stage.reused ? [" ", h("small", { class: "q" }, stage.reused === stage.shards ? "reused" : `${stage.reused} of ${stage.shards} reused`)] : [])), h("td", { class: "r nw" }, duration(stage.seconds)), h("td", { class: "st-bar" }, bar(stage.seconds / longest)),
      ...(memory ? [h("td", { class: "r nw" }, known(stage.peak_bytes) ? bytes(stage.peak_bytes) : "—"), h("td", { class: "st-bar" }, bar((stage.peak_bytes ?? 0) / largest))] : [])));
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Seconds and peak memory of each stage"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Stage"), h("th", { scope: "col", class: "r" }, "Time"), h("th", null, h("span", { class: "sr" }, "Time as a bar")),
      ...(memory ? [h("th", { scope: "col", class: "r" }, "Peak memory"), h("th", null, h("span", { class: "sr" }, "Memory as a bar"))] : []))), h("tbody", null, ...rows));
  const total = [known(report.seconds) ? duration(report.seconds) : "", known(report.peak_bytes) ? `${bytes(report.peak_bytes)} at most in one process` : ""].filter(Boolean).join(", ");
  const button = csvButton("stages", ["stage", "seconds", "peak_bytes", "skipped", "shards", "reused"], () => report.stages.map((stage) => [stage.name, stage.seconds, stage.peak_bytes, stage.skipped, stage.shards, stage.reused]));
  return part("st-h", "Stages", total, button, scroller(table));
}

export function deviceTable(report: Report): HTMLElement | null {
  const { device } = report;
  if (!device) return null;
  const ns = (value: number): string => `${Number(value.toPrecision(4))} ns`;
  const rows: Row[] = [
    ["A frame", ns(device.per_frame_ns), "before anything is drawn"],
    ["A draw call", ns(device.per_call_ns), ""],
    ["A triangle", ns(device.per_triangle_ns), ""],
    ["A pixel", ns(device.per_pixel_ns), ""],
    ["An impostor", ns(device.per_impostor_ns), ""],
    ["A triangle of its layers", ns(device.per_impostor_triangle_ns), ""],
    ["A pixel of its layers", ns(device.per_impostor_pixel_ns), ""],
  ];
  const { fit } = device;
  if (fit) {
    rows.push(
      ["Predicted − measured, mean", `${fit.mean_ms.toFixed(2)} ms`, `of ${plural(fit.samples, "frame")}`],
      ["95 % of these below", `${fit.p95_ms.toFixed(2)} ms`, ""],
      ["Took longer than predicted", `${(100 * fit.under_share).toFixed(1)} %`, `at worst by ${fit.worst_ms.toFixed(2)} ms`],
      ["The same, frames not fitted to", `${(100 * fit.unseen_under_share).toFixed(1)} %`, "five fits over a fifth each"],
    );
  }
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "Device profile"), h("tbody", null, ...rows.map(([name, value, hint]) =>
    h("tr", null, h("th", { scope: "row" }, name, hint ? h("small", { class: "q" }, hint) : null), h("td", { class: "r nw" }, value)))));
  const hint = fit ? "fitted to measured frames, an upper bound" : "a preset, not measured";
  return part("dv-h", `Device ${device.name}`, hint, csvButton("device", ["figure", "value", "note"], () => rows), scroller(table));
}

export function worstViews(report: Report, placement: string): HTMLElement | null {
  const views = report.worst_views ?? [];
  if (!views.length) return null;
  const unit = report.unit ?? "";
  const budget = report.budget_amount ?? Infinity;
  const rows = views.map((v) => h("tr", null, h("td", { class: "c-dir" }, compass(v.direction)), h("td", { class: "mono nw c-cell" }, `${v.cell} · ${bearing(v.direction)}°`),
    h("td", { class: "r nw c-geo" }, costText(v.geometry_cost, unit)), h("td", { class: "r nw" }, h("b", v.cost_bound > budget ? { class: "over" } : null, costText(v.cost_bound, unit)), v.hopeless ? h("small", { class: "q", title: "hopeless" }, " hopeless") : null),
    h("td", { class: "r c-open noprint" }, h("a", { class: "nw", href: viewAddress(placement, v.position, v.direction) }, "Open"))));
  const table = h("table", { class: "num ht" }, h("caption", { class: "sr" }, "Views with the highest bound"),
    h("thead", null, h("tr", null, h("th", null, h("span", { class: "sr" }, "Direction")), h("th", null, "Cell"), h("th", { class: "r" }, "Geometry"), h("th", { class: "r" }, "As placed"), h("th", { class: "noprint" }, h("span", { class: "sr" }, "Viewer")))), h("tbody", null, ...rows));
  const button = csvButton("worst-views", ["problem_view", "cell", "interval", "x_m", "y_m", "z_m", "direction_x", "direction_y", "direction_z", `geometry_${unit}`, `bound_${unit}`, "impostors", "hopeless"],
    () => views.map((v) => [v.problem_view, v.cell, v.interval, ...v.position, ...v.direction, v.geometry_cost, v.cost_bound, v.impostors, v.hopeless ? 1 : 0]));
  return part("wv-h", "Worst views", "highest bound on the cost, as placed", button, scroller(table));
}

/** What the level did not need, and about what that saved. */
export function leftOut(report: Report): HTMLElement | null {
  const rows = report.left_out ?? [];
  if (!rows.length) return null;
  const saved = (seconds: [number, number] | null): string =>
    seconds === null ? "—" : seconds[0] === seconds[1] ? duration(seconds[0]) : `${duration(seconds[0])} to ${duration(seconds[1])}`;
  const table = h("table", { class: "num" }, h("caption", { class: "sr" }, "What was left out, and what that saved"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Not needed"), h("th", { scope: "col" }, "Why"), h("th", { scope: "col", class: "r" }, "Saved, about"), h("th", { scope: "col" }, "Estimated from"))),
    h("tbody", null, ...rows.map((row) => h("tr", null, h("th", { scope: "row" }, row.need, row.stages.length ? h("small", { class: "q" }, ` ${row.stages.join(", ")}`) : null),
      h("td", null, row.why), h("td", { class: "r nw" }, saved(row.seconds)), h("td", { class: "q2" }, row.basis)))));
  const button = csvButton("left-out", ["need", "why", "stages", "seconds_least", "seconds_most", "basis"], () => rows.map((row) => [row.need, row.why, row.stages.join(" "), row.seconds?.[0] ?? null, row.seconds?.[1] ?? null, row.basis]));
  return part("lo-h", "Left out", "seconds of one processor", button, scroller(table));
}

export function notes(report: Report): HTMLElement | null {
  const lines = [...(report.warnings ?? []), ...(report.not_baked ?? [])];
  for (const { look, objects, geometry, flattened } of report.looks ?? []) {
    lines.push(`${plural(objects, "object")} ${look}: ${geometry} stay geometry, ${flattened} baked as they stand`);
  }
  if (report.dropped_triangles) lines.push(`${plural(report.dropped_triangles, "triangle")} without area ignored`);
  if (!lines.length) return null;
  return part("nt-h", "Notes", "", null, h("ul", { class: "warn" }, ...lines.map((l) => h("li", { class: "q2" }, icon("note"), h("span", null, l)))));
}
