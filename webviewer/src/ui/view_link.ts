/** A view in an address: /viewer/NAME#at=x,y,z&to=dx,dy,dz. Fragments stay in the browser; all digits are kept. */
import type { Vec3 } from "../placementdb/manifest";

export function viewAddress(placement: string, position?: readonly number[], direction?: readonly number[]): string {
  const base = `/viewer/${encodeURIComponent(placement)}`;
  return position && direction ? `${base}#at=${position.join(",")}&to=${direction.join(",")}` : base;
}

/** The view that a fragment names; null where it names none. */
export function readView(fragment: string): { position: Vec3; direction: Vec3 } | null {
  const given = new URLSearchParams(fragment.replace(/^#/, ""));
  const position = vector(given.get("at"));
  const direction = vector(given.get("to"));
  return position && direction && Math.hypot(...direction) > 0 ? { position, direction } : null;
}

function vector(text: string | null): Vec3 | null {
  const parts = (text ?? "").split(",").map((t) => (t.trim() === "" ? NaN : Number(t)));
  return parts.length === 3 && parts.every(Number.isFinite) ? (parts as Vec3) : null;
}
