/** The plan of a level with its picture from above; the list of its objects, which may be long, only where there is none. */
import { readObjects } from "../api/client";
import type { Box, Scene } from "../api/types";
import { scenePlan } from "./scene_plan";

export async function readPlan(scene: Scene, bounds: Box, viewSpace: readonly Box[]): Promise<SVGSVGElement> {
  const picture = scene.links?.picture ?? null;
  if (picture) return scenePlan([], bounds, viewSpace, picture);
  const { objects } = await readObjects(scene.digest).catch(() => ({ objects: [] }));
  return scenePlan(objects.map((o) => o.box), bounds, viewSpace);
}
