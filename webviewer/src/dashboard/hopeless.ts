/** Hopeless views with the objects to blame: by view, or by object; each view opens in the viewer. */
import { bearing, cost as costText, count } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { csv, download } from "../ui/csv";
import { h, s, scroller } from "./element";
import { plural } from "./format";
import type { Culprit, HopelessView, Report } from "./report_types";

const SHOWN = 20;

export function hopelessPanel(report: Report, placement: string, select?: (cell: number) => void): HTMLElement | null {
  const views = report.hopeless ?? [];
  if (!views.length) return null;
  const unit = report.unit ?? "";
  const total = report.hopeless_views ?? views.length;
  const body = h("div");
  const choose = (by: string): void => body.replaceChildren(...(by === "view" ? byView(views, report, placement, select) : byObject(report.culprits ?? [])));
  const radio = (value: string, word: string): HTMLElement => h("label", null, h("input", { type: "radio", name: "hopeless-by", checked: value === "view", onchange: () => choose(value) }), word);
  choose("view");
  const cells = new Set(views.map((v) => v.cell)).size;
  const spread = total <= views.length ? ` in ${plural(cells, "cell")}` : `; the ${views.length} farthest from the budget are listed`;
  const save = (): void => download("hopeless-views.csv", csv(
    ["problem_view", "cell", "interval", "x_m", "y_m", "z_m", "direction_x", "direction_y", "direction_z", `geometry_${unit}`, `best_${unit}`, "culprit_ids", "culprit_names"],
    views.map((v) => [v.problem_view, v.cell, v.interval, ...v.position, ...v.direction, v.geometry_cost, v.best, v.culprits.map((c) => c.id).join(" "), v.culprits.map(nameOf).join(" ")])));
  return h("section", { class: "panel report-part", id: "hopeless", "aria-labelledby": "hh" },
    h("header", null, h("h2", { id: "hh" }, "Hopeless views"), h("span", { class: "small q" }, `${plural(total, "view")}${spread}`),
      h("div", { class: "end" }, report.culprits?.length ? h("div", { class: "seg noprint", role: "radiogroup", "aria-label": "Group by" }, radio("view", "By view"), radio("object", "By object")) : null,
        h("button", { class: "btn plain noprint", type: "button", onclick: save }, "CSV"))), wayOut(report), body);
}

/** The smallest budget that all views meet with these candidates: what to ask for, or what to work towards. */
function wayOut(report: Report): HTMLElement | null {
  const smallest = report.smallest_budget?.text;
  return smallest ? h("p", { class: "small q2" }, "Smallest budget that works: ", h("b", null, smallest), report.budget ? `, against ${report.budget} now. ` : ". ",
    "Or make the objects to blame lighter: no impostor can stand for what is this near.") : null;
}

function byView(views: readonly HopelessView[], report: Report, placement: string, select?: (cell: number) => void): HTMLElement[] {
  const unit = report.unit ?? "";
  const budget = report.budget_amount ?? 0;
  const rows = views.map((v) => {
    const culprits = v.culprits.slice(0, 3).map(nameOf).join(", ");
    const rest = v.culprits.length - 3;
    const row = h("tr", null, h("td", { class: "c-dir" }, compass(v.direction)), h("td", { class: "c-cell mono nw" }, `${v.cell} · ${bearing(v.direction)}°`),
      h("td", { class: "r c-geo nw" }, costText(v.geometry_cost, unit)),
      h("td", { class: "r nw c-best" }, h("b", { class: "over" }, costText(v.best, unit)), " ", h("span", { class: "q" }, `+${costText(v.best - budget, unit).replace(/ .*/, "")}`)),
      h("td", { class: "c-cul" }, h("span", { class: "mono" }, culprits || "—"), rest > 0 ? h("span", { class: "q" }, ` and ${rest} more`) : null,
        v.culprits.length ? h("br") : null, v.culprits.length ? h("small", { class: "q" }, `${plural(sum(v.culprits, "triangles"), "triangle")}, ${plural(sum(v.culprits, "calls"), "call")}`) : null),
      h("td", { class: "r c-open noprint" }, h("a", { class: "nw", href: viewAddress(placement, v.position, v.direction) }, "Open view")));
    if (select) row.addEventListener("focusin", () => select(v.cell));
    if (select) row.addEventListener("pointerenter", () => select(v.cell));
    return row;
  });
  const table = h("table", { class: "ht" }, h("caption", { class: "sr" }, "Hopeless views, farthest from the budget first"),
    h("thead", null, h("tr", null, h("th", null, h("span", { class: "sr" }, "Direction")), h("th", null, "Cell"), h("th", { class: "r" }, "Geometry"), h("th", { class: "r" }, "Best possible"), h("th", null, "To blame"), h("th", { class: "noprint" }, h("span", { class: "sr" }, "Viewer")))),
    h("tbody", null, ...rows.slice(0, SHOWN)));
  const more = h("div", { class: "more noprint" });
  if (rows.length > SHOWN) {
    more.append(h("button", { type: "button", onclick: () => (table.tBodies[0].append(...rows.slice(SHOWN)), more.remove()) }, `Show all ${rows.length}`));
  }
  return [scroller(table), more];
}

function byObject(culprits: readonly Culprit[]): HTMLElement[] {
  return [h("table", { class: "num" }, h("caption", { class: "sr" }, "Objects that spoil views"),
    h("thead", null, h("tr", null, h("th", null, "Object"), h("th", { class: "r" }, "Views spoiled"), h("th", { class: "r" }, "Triangles"), h("th", { class: "r" }, "Calls"))),
    h("tbody", null, ...culprits.map((c) => h("tr", null, h("td", { class: "mono c-cul" }, nameOf(c)), h("td", { class: "r" }, count(c.hopeless_views ?? 0)), h("td", { class: "r" }, count(c.triangles)), h("td", { class: "r" }, count(c.calls))))))];
}

function nameOf(c: Culprit): string {
  return c.name || `object ${c.id}`;
}

function sum(culprits: readonly Culprit[], key: "triangles" | "calls"): number {
  return culprits.reduce((n, c) => n + c[key], 0);
}

/** Where the view looks, from above: up is -z, as on the map. */
export function compass(direction: ArrayLike<number>): SVGSVGElement {
  const angle = (bearing(direction) * Math.PI) / 180;
  const at = (a: number): string => `${(11 + 9.5 * Math.sin(a)).toFixed(1)} ${(11 - 9.5 * Math.cos(a)).toFixed(1)}`;
  return s("svg", { class: "dirg", viewBox: "0 0 22 22", role: "img", "aria-label": `towards ${bearing(direction)} degrees` },
    s("circle", { cx: 11, cy: 11, r: 9.5 }), s("path", { d: `M11 11L${at(angle - 0.25)}A9.5 9.5 0 0 1 ${at(angle + 0.25)}z` }));
}
