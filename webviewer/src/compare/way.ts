/** A way to draw the level: what each row of the comparison is. */
import type { Engine } from "../viewer/engine";
import type { Placement } from "../placementdb/placement";
import type { Vec3 } from "../placementdb/manifest";
import type { Frame } from "./frame";
import type { Whole } from "./whole";

export interface Way {
  /** Resolves when everything that a view needs is in video memory; true: it had to be fetched. */
  settle(position: Vec3, direction: Vec3): Promise<boolean>;
  /** Draws one frame into the canvas. */
  draw(position: Vec3, direction: Vec3): void;
  /** What it counts itself, to be held against what reached WebGL; null: it does not. */
  claimed: { calls: number; triangles: number } | null;
  preparedBytes: number; // what a studio would have to store beside the level
  /** Facts of this way for the row, in words. */
  said: string;
}

export interface Given {
  engine: Engine;
  placement: Placement;
  frame: Frame;
  /** Parses the level and hands all of it to the way. */
  whole: () => Promise<Whole>;
}

export const here = async (): Promise<boolean> => false;
