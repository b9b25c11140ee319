/** Plans: what a level is from above, x to the right, z downwards, in metres. */
import type { Box } from "../api/types";
import { s } from "./element";

export interface Plane {
  low: [number, number]; // x, z
  high: [number, number];
}

/** The rectangle that holds the boxes and has the aspect of the picture. */
export function planeOf(boxes: readonly Box[], aspect: number): Plane {
  const low: [number, number] = [Infinity, Infinity];
  const high: [number, number] = [-Infinity, -Infinity];
  for (const [a, b] of boxes) {
    low[0] = Math.min(low[0], a[0]);
    low[1] = Math.min(low[1], a[2]);
    high[0] = Math.max(high[0], b[0]);
    high[1] = Math.max(high[1], b[2]);
  }
  if (!(low[0] <= high[0])) return { low: [0, 0], high: [aspect, 1] };
  const margin = 0.02 * Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
  let wide = high[0] - low[0] + 2 * margin;
  let deep = high[1] - low[1] + 2 * margin;
  if (wide < aspect * deep) wide = aspect * deep;
  else deep = wide / aspect;
  const x = (low[0] + high[0]) / 2;
  const z = (low[1] + high[1]) / 2;
  return { low: [x - wide / 2, z - deep / 2], high: [x + wide / 2, z + deep / 2] };
}

export function viewBoxOf(plane: Plane): string {
  return [plane.low[0], plane.low[1], plane.high[0] - plane.low[0], plane.high[1] - plane.low[1]].join(" ");
}

/** One path for all boxes: a level has thousands. Coordinates are rounded to a ten-thousandth of the plan. */
export function boxesPath(boxes: Iterable<Box>, plane: Plane): string {
  const step = (plane.high[0] - plane.low[0]) / 10_000;
  const digits = Math.max(0, Math.ceil(-Math.log10(step)));
  const f = (x: number): string => String(Number(x.toFixed(digits)));
  let d = "";
  for (const [a, b] of boxes) d += `M${f(a[0])} ${f(a[2])}H${f(b[0])}V${f(b[2])}H${f(a[0])}z`;
  return d;
}

/** A band that follows the ground has thousands of boxes: their outlines would be all that is seen. */
const OUTLINED = 24;

export function planCaption(viewSpace: readonly Box[]): string {
  return `${viewSpace.length > OUTLINED ? "shaded" : "dashed"}: where the camera may be`;
}

const PICTURE_PX = 512; // of the longer side, services/farfield/scene/picture.py

/** Where the picture from above lies, metres: its pixels are squares, its sides were rounded up to whole ones. */
export function pictureFrame([low, high]: Box): { x: number; y: number; width: number; height: number } {
  const extent = Math.max(high[0] - low[0], high[2] - low[2]);
  const side = (axis: 0 | 2): number => (Math.max(1, Math.ceil(((high[axis] - low[axis]) * PICTURE_PX) / extent - 1e-9)) * extent) / PICTURE_PX;
  return { x: low[0], y: low[2], width: side(0), height: side(2) };
}

/** Footprints, or a picture of the level from above where there is one, and the suggested view space over it. */
export function scenePlan(objects: readonly Box[], bounds: Box, viewSpace: readonly Box[], picture: string | null = null): SVGSVGElement {
  const plane = planeOf([bounds], 1.5);
  const area = (bounds[1][0] - bounds[0][0]) * (bounds[1][2] - bounds[0][2]);
  // What covers much of the plan is ground or sky, whole or split into tiles: it would hide the rest.
  const within = (share: number): Box[] => objects.filter(([a, b]) => (b[0] - a[0]) * (b[2] - a[2]) < share * area);
  const small = within(0.01);
  const footprints = small.length > objects.length / 2 ? small : within(0.25);
  const shown = picture !== null && area > 0;
  const seen = shown ? s("image", { href: picture, ...pictureFrame(bounds), preserveAspectRatio: "none" }) : null;
  seen?.addEventListener("error", () => seen.remove()); // the view space alone says where things are
  return s("svg", { class: shown ? "plan seen" : "plan", viewBox: viewBoxOf(plane), role: "img", "aria-label": shown ? "The level from above with the suggested view space" : "Plan of the level with the suggested view space" },
    seen, s("path", { class: "f", d: boxesPath(footprints, plane) }), s("path", { class: viewSpace.length > OUTLINED ? "v many" : "v", d: boxesPath(viewSpace, plane) }));
}
