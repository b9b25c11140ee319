/**
 * A link that holds view, toggles and walk: `#at=x,y,z&to=dx,dy,dz&show=il&cut=0.5&held=12.7&walk=...`. What it does not name stays as it is.
 *
 * `show` names what is on, a letter each, the letters of the keys; `cut` is where the divider stands; `held` the cell and interval that
 * are frozen.
 */
import type { Vec3 } from "../placementdb/manifest";
import { WalkDamaged, decodeWalk, encodeWalk, type Walk } from "../walk/walk";
import { readView } from "./view_link";

export const TOGGLE_LETTERS = "ixbelcgm";

export interface Shared {
  view: { position: Vec3; direction: Vec3 } | null;
  show: string | null; // letters of TOGGLE_LETTERS
  cut: number | null;
  held: { cell: number; interval: number } | null;
  walk: Walk | null;
}

export function sharedFragment(shared: Shared): string {
  const parts: string[] = [];
  const { view, show, cut, held, walk } = shared;
  if (view) parts.push(`at=${view.position.join(",")}`, `to=${view.direction.join(",")}`);
  if (show !== null) parts.push(`show=${show}`);
  if (cut !== null) parts.push(`cut=${cut}`);
  if (held) parts.push(`held=${held.cell}.${held.interval}`);
  if (walk) parts.push(`walk=${encodeWalk(walk)}`);
  return `#${parts.join("&")}`;
}

/** What a fragment names; `refused` says in words what of it could not be read (the rest still counts). */
export function readShared(fragment: string): Shared & { refused: string } {
  const given = new URLSearchParams(fragment.replace(/^#/, ""));
  const shared: Shared & { refused: string } = { view: readView(fragment), show: null, cut: null, held: null, walk: null, refused: "" };
  const show = given.get("show");
  if (show !== null) shared.show = [...TOGGLE_LETTERS].filter((letter) => show.includes(letter)).join("");
  const cut = given.get("cut");
  if (cut && Number(cut) >= 0 && Number(cut) <= 1) shared.cut = Number(cut);
  const held = /^(\d{1,9})\.(\d{1,9})$/.exec(given.get("held") ?? "");
  if (held) shared.held = { cell: Number(held[1]), interval: Number(held[2]) };
  const walk = given.get("walk");
  if (walk === null) return shared;
  try {
    shared.walk = decodeWalk(walk);
  } catch (error) {
    shared.refused = error instanceof Error ? error.message : new WalkDamaged(String(error)).message;
  }
  return shared;
}
