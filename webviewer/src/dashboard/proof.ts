/** What the proof by pictures found, and its worst pairs: geometry, impostor, difference. */
import { count } from "../ui/format";
import { viewAddress } from "../ui/view_link";
import { h, scroller } from "./element";
import { plural } from "./format";
import { csvButton, part } from "./report_parts";
import type { Proof, ProofPair, Report } from "./report_types";

const SHOWN = [["geometry", "Geometry"], ["impostor", "Impostor"], ["difference", "Difference × 4"]] as const;

export function proofPanel(report: Report, placement: string): HTMLElement | null {
  const proof = report.proof;
  if (!proof) return null;
  if (!proof.pairs) {
    return proof.not_proven ? part("pf-h", "Pictures", "", null, h("p", { class: "small q" }, `Impostors were not compared with their geometry: ${proof.not_proven}`)) : null;
  }
  const px = (x: number): string => `${x.toFixed(3)} px`;
  const percent = `${(100 * proof.failing_share_upper).toFixed(2)} %`;
  const rows: [string, string, string][] = [
    ["Pairs of impostor and viewpoint", count(proof.pairs), `${plural(proof.impostors, "impostor")} of ${count(proof.impostors_shown)}`],
    ["Failed", count(proof.failed), proof.failed ? `impostors ${proof.failed_impostors.join(", ")}` : `fewer than ${percent} of all pairs, at ${100 * proof.confidence} % confidence`],
    ["Crack pixels", count(proof.crack_px), `of ${count(proof.pixels)}`],
    ["Largest displacement", px(proof.worst_displacement_px), `${proof.allowed_px?.toFixed(2)} px allowed; mean ${px(proof.mean_displacement_px)}`],
    ["FLIP", proof.flip.toFixed(3), `95th percentile ${proof.flip_p95.toFixed(3)}, over ${count(proof.pixels_in_view)} pixels in view`],
  ];
  const table = h("table", null, h("caption", { class: "sr" }, "What pictures prove"), h("tbody", null,
    ...rows.map(([name, value, hint]) => h("tr", null, h("th", { scope: "row" }, name), h("td", { class: "r nw" }, value), h("td", { class: "small q" }, hint)))));
  const header = ["impostor", "crack_px", "displacement_px", "flip", "flip_p95"];
  const button = csvButton("worst-pairs", header, () => proof.worst.map((w) => [w.impostor, w.crack_px, w.displacement_px, w.flip, w.flip_p95]));
  return part("pf-h", "Pictures", "with impostors against with geometry, the whole level around them", button, scroller(table),
    h("div", { class: "proof" }, ...proof.worst.filter((w) => w.pictures).map((w) => pair(w, placement, proof))));
}

function pair(worst: ProofPair, placement: string, proof: Proof): HTMLElement {
  const failed = proof.failed_impostors.includes(worst.impostor) ? "failed, " : "";
  return h("figure", null,
    h("div", null, ...SHOWN.map(([key, name]) => h("img", { src: worst.pictures![key], alt: `${name} of impostor ${worst.impostor}`, title: name }))),
    h("figcaption", { class: "small q" }, h("a", { href: viewAddress(placement, worst.position, worst.direction) }, `Impostor ${worst.impostor}`),
      `: ${failed}${plural(worst.crack_px, "crack pixel")}, ${worst.displacement_px.toFixed(2)} px, FLIP ${worst.flip.toFixed(3)}`));
}
