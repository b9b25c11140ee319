/** The certificate's worst views as bookmarks: the report's list, one key or click each. A placement without a report has none. */
import type { Manifest, Vec3 } from "../placementdb/manifest";
import { byId, setShown } from "../ui/dom";
import { bearing, count } from "../ui/format";
import { viewAddress } from "../ui/view_link";

export interface WorstView {
  position: Vec3;
  direction: Vec3;
  cell: number;
  cost: number; // that the certificate states for it
  hopeless: boolean;
}

const MOST = 9;

/** The worst views of a report's JSON, the costliest first; what is not readable is left out. */
export function readWorstViews(report: unknown): WorstView[] {
  const listed = (report as { worst_views?: unknown } | null)?.worst_views;
  const out: WorstView[] = [];
  for (const view of Array.isArray(listed) ? (listed as Record<string, unknown>[]) : []) {
    const { position, direction, cell, cost_bound: cost } = view ?? {};
    if (!isVector(position) || !isVector(direction) || !direction.some(Boolean) || !Number.isFinite(cost)) continue;
    out.push({ position, direction, cell: Number(cell), cost: cost as number, hopeless: view.hopeless === true });
  }
  return out.sort((a, b) => b.cost - a.cost).slice(0, MOST);
}

function isVector(value: unknown): value is Vec3 {
  return Array.isArray(value) && value.length === 3 && value.every((x) => Number.isFinite(x));
}

export class WorstViews {
  private views: WorstView[] = [];
  private links: HTMLAnchorElement[] = [];

  /** `go` looks from a view. */
  constructor(
    private readonly manifest: Manifest,
    private readonly id: string,
    private readonly go: (view: WorstView) => void,
  ) {}

  show(views: WorstView[]): void {
    this.views = views;
    const { unit } = this.manifest.budget;
    this.links = views.map((view, k) => this.link(view, k, unit));
    byId("worst-list").replaceChildren(...this.links);
    byId("worst-unit").textContent = unit === "ns" ? "stated ms" : `stated ${unit}`;
    setShown("worst", views.length > 0);
  }

  /** Looks from view k, 0 the worst; false where there is none. */
  open(k: number): boolean {
    if (!this.views[k]) return false;
    this.go(this.views[k]);
    this.links.forEach((link, i) => (i === k ? link.setAttribute("aria-current", "true") : link.removeAttribute("aria-current")));
    return true;
  }

  /** The camera has left the bookmark. */
  leave(): void {
    for (const link of this.links) if (link.hasAttribute("aria-current")) link.removeAttribute("aria-current");
  }

  private link(view: WorstView, k: number, unit: string): HTMLAnchorElement {
    const part = (tag: string, text: string, name = ""): HTMLElement => {
      const element = document.createElement(tag);
      element.textContent = text;
      if (name) element.className = name;
      return element;
    };
    const degrees = bearing(view.direction);
    const told = unit === "ns" ? (view.cost / 1e6).toFixed(2) : count(view.cost);
    const link = document.createElement("a");
    link.href = viewAddress(this.id, view.position, view.direction);
    link.append(part("kbd", String(k + 1)), part("span", `${view.cell}, ${degrees}°`, "mono"), part("b", view.hopeless ? `${told} hopeless` : told));
    link.setAttribute("aria-label", `Worst view ${k + 1}: cell ${view.cell}, ${degrees} degrees from north, ${told} ${unit === "ns" ? "ms" : unit}${view.hopeless ? ", hopeless" : ""}`);
    link.addEventListener("click", (e) => {
      if (e.ctrlKey || e.metaKey || e.shiftKey || e.button) return; // another tab
      e.preventDefault();
      this.open(k);
    });
    return link;
  }
}
