/** States: shape and word carry them, colour only helps. */
import type { JobState, StageState, Verdict } from "../api/types";
import { h, s } from "./element";

const SHAPES: Record<string, [string, boolean?][]> = {
  run: [["M2 8a6 6 0 1 0 12 0 6 6 0 1 0-12 0z"], ["M8 2a6 6 0 0 1 0 12z", true]],
  queue: [["M2 8a6 6 0 1 0 12 0 6 6 0 1 0-12 0z"]],
  infeas: [["M8 2l6.5 11.5h-13z"], ["M8 6v3.6M8 11.2v1.2"]],
  fail: [["M5.2 1.8h5.6l3.4 3.4v5.6l-3.4 3.4H5.2l-3.4-3.4V5.2z"], ["M5.6 5.6l4.8 4.8M10.4 5.6l-4.8 4.8"]],
  cancel: [["M2 8a6 6 0 1 0 12 0 6 6 0 1 0-12 0z"], ["M4 12l8-8"]],
  done: [["M2.5 8.5l3.6 3.8L13.5 4"]],
  note: [["M8 2.5v7M8 11.5v2"]],
  theme: [["M2 8a6 6 0 1 0 12 0 6 6 0 1 0-12 0z"], ["M8 2a6 6 0 0 0 0 12z", true]],
};

export function icon(name: string): SVGSVGElement {
  const svg = s("svg", { class: "i", viewBox: "0 0 16 16", "aria-hidden": "true" });
  if (name === "valid") {
    svg.append(s("path", { d: "M1.5 1.5h13v13h-13z", fill: "currentColor" }), s("path", { d: "M4.5 8.2l2.4 2.5 4.6-5.2", class: "i-cut" }));
  } else if (name === "unproven") {
    svg.append(s("path", { d: "M1.5 1.5h13v13h-13z", "stroke-dasharray": "2.6 2" }), s("path", { d: "M6 6.3a2 2 0 1 1 2.6 1.9c-.5.2-.6.5-.6 1.1M8 11v1.2" }));
  } else if (name === "skip") {
    svg.append(s("path", { d: "M2 8h12M10 4l4 4-4 4", "stroke-dasharray": "3 2" }));
  } else {
    for (const [d, filled] of SHAPES[name] ?? []) svg.append(s("path", filled ? { d, fill: "currentColor" } : { d }));
  }
  return svg;
}

export function stateMark(kind: string, shape: string, word: string): HTMLElement {
  return h("span", { class: `st ${kind}` }, icon(shape), word);
}

const JOB: Record<JobState, [string, string]> = {
  queued: ["idle", "queue"], running: ["run", "run"], done: ["idle", "done"], failed: ["bad", "fail"], cancelled: ["idle", "cancel"],
};
export const jobMark = (state: JobState): HTMLElement => stateMark(...JOB[state], state);

const VERDICT: Record<Verdict, [string, string]> = { valid: ["ok", "valid"], infeasible: ["inf", "infeas"], unproven: ["idle", "unproven"] };
export const verdictMark = (verdict: Verdict): HTMLElement => stateMark(...(VERDICT[verdict] ?? VERDICT.unproven), verdict);

export function stageIcon(state: StageState, skipped: string | null): string {
  if (state === "failed") return "fail";
  if (skipped !== null || state === "skipped") return "skip";
  return state === "done" ? "done" : state === "waiting" ? "queue" : "run";
}
