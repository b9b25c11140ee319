/** Cost over direction at the camera: what turning on the spot costs, with and without impostors (2005 paper, figure 6). */
import { chunkOfCell, impostorsOfView, viewInChunk, visibleOfCell, type Placement } from "../placementdb/placement";
import type { Vec3 } from "../placementdb/manifest";
import { findCell } from "../select/cells";
import { cameraFrame, makeFrustum, setFrustum } from "../select/frustum";
import { findInterval } from "../select/intervals";
import { Selector } from "../select/select";

export const DIRECTIONS = 64;

export class Panorama {
  readonly cost = new Float64Array(DIRECTIONS);
  readonly geometryCost = new Float64Array(DIRECTIONS);
  readonly problem = new Uint8Array(DIRECTIONS);
  private readonly placement: Placement;
  private readonly selector: Selector;
  private readonly frustum = makeFrustum();

  constructor(placement: Placement) {
    this.placement = placement;
    this.selector = new Selector(placement.index, placement.manifest);
  }

  /** Azimuth 0 is north (-z), clockwise; false where the position has no cell or its chunk is not here. */
  update(position: Vec3, pitch: number): boolean {
    const { manifest, index } = this.placement;
    const cell = findCell(index, manifest, position);
    if (cell < 0) return false;
    const number = chunkOfCell(manifest, cell);
    const chunk = number < 0 ? null : (this.placement.residentChunk(number) ?? null);
    if (number >= 0 && !chunk) return false;
    const visible = visibleOfCell(chunk, cell);
    const { fov_deg, width, height } = manifest.camera;
    let last = -2;
    for (let k = 0; k < DIRECTIONS; k++) {
      const azimuth = (2 * Math.PI * k) / DIRECTIONS;
      const d: Vec3 = [Math.sin(azimuth) * Math.cos(pitch), Math.sin(pitch), -Math.cos(azimuth) * Math.cos(pitch)];
      const view = chunk ? viewInChunk(chunk, cell, findInterval(manifest.interval_edges, d)) : -1;
      if (view !== last) this.selector.setView(cell, visible, chunk, view < 0 ? [] : Array.from(impostorsOfView(chunk!, view)));
      last = view;
      setFrustum(this.frustum, cameraFrame(position, d), fov_deg, width / height);
      for (let a = 0; a < 3; a++) this.frustum.eye[a] = position[a] - manifest.origin_m[a];
      const s = this.selector.select(this.frustum);
      this.cost[k] = s.cost;
      this.geometryCost[k] = s.geometryCost;
      this.problem[k] = view >= 0 ? 1 : 0;
    }
    return true;
  }
}
