/**
 * What a frame draws: the cell's visible objects whose box meets the view pyramid, less those an impostor of the problem
 * view covers, plus those impostors; and what that costs by the manifest's cost model, each object at its cell's level.
 *
 * Only impostors that are resident cover anything: until their pages are here their objects are drawn as geometry.
 */
import type { PlacementChunk } from "../placementdb/chunk";
import type { PlacementIndex } from "../placementdb/index_file";
import type { CostModel, Manifest } from "../placementdb/manifest";
import { costAt, setLevels, trianglesAt } from "./levels";
import { boxInside, boxMeets, type Frustum } from "./frustum";
import { boxPixels, polygonPixels } from "./pixels";

/** What a frame draws, in arrays that are filled anew every frame and never grow. */
export interface Selection {
  objects: Int32Array; // ids to draw as geometry: the first nObjects entries
  nObjects: number;
  levels: Uint8Array; // by object id, not by entry: at which level to draw it, 0 the object itself
  calls: number;
  triangles: number;
  cost: number; // per_frame included
  geometryObjects: number; // what the same view would be without impostors
  geometryTriangles: number;
  geometryCost: number;
}

const HIDDEN = 0;
const SEEN = 1;
const COVERED = 2;

export class Selector {
  readonly selection: Selection;
  private readonly mask: Uint8Array;
  private readonly stack: Int32Array;
  private readonly index: PlacementIndex;
  private readonly model: CostModel;
  private readonly width: number;
  private readonly height: number;
  private cell = -1;
  private chunk: PlacementChunk | null = null;
  private shown: readonly number[] = [];

  constructor(index: PlacementIndex, manifest: Manifest) {
    this.index = index;
    this.model = manifest.cost_model;
    this.width = manifest.camera.width;
    this.height = manifest.camera.height;
    const n = manifest.counts.objects;
    this.mask = new Uint8Array(n).fill(SEEN);
    this.stack = new Int32Array(2 * index.clusterStart.length + 2);
    this.selection = {
      objects: new Int32Array(n), nObjects: 0, levels: new Uint8Array(n), calls: 0, triangles: 0, cost: 0,
      geometryObjects: 0, geometryTriangles: 0, geometryCost: 0,
    };
  }

  /** Called when cell, interval or residency change. `shown` are local impostors of the chunk; null visible: all. */
  setView(cell: number, visible: Int32Array | null, chunk: PlacementChunk | null, shown: readonly number[]): void {
    const { mask, index } = this;
    if (cell !== this.cell) setLevels(index, cell, this.selection.levels);
    this.cell = cell;
    mask.fill(visible ? HIDDEN : SEEN);
    if (visible) for (let k = 0; k < visible.length; k++) mask[visible[k]] = SEEN;
    this.chunk = chunk;
    this.shown = shown;
    if (!chunk) return;
    for (const m of shown) {
      const cluster = index.impostorCluster[chunk.impostorId[m]];
      for (let o = index.clusterStart[cluster]; o < index.clusterStop[cluster]; o++) if (mask[o] === SEEN) mask[o] = COVERED;
    }
  }

  /** Fills `selection` for a frustum whose eye is relative to origin_m. */
  select(frustum: Frustum): Selection {
    const s = this.selection;
    s.nObjects = s.calls = s.triangles = s.geometryObjects = s.geometryTriangles = 0;
    s.cost = s.geometryCost = this.model.per_frame;
    const { clusterLeft, clusterRight, clusterStart, clusterStop, clusterBox, objectBox } = this.index;
    let top = 0;
    // The low bit says that the parent's box lies inside the pyramid as a whole: nothing below need be tested.
    if (clusterStart.length) this.stack[top++] = 0;
    while (top > 0) {
      const entry = this.stack[--top];
      const cluster = entry >> 1;
      let inside = (entry & 1) === 1;
      if (!inside) {
        if (!boxMeets(frustum, clusterBox, 6 * cluster)) continue;
        inside = boxInside(frustum, clusterBox, 6 * cluster);
      }
      if (clusterLeft[cluster] >= 0) {
        const bit = inside ? 1 : 0;
        this.stack[top++] = (clusterRight[cluster] << 1) | bit;
        this.stack[top++] = (clusterLeft[cluster] << 1) | bit;
        continue;
      }
      for (let o = clusterStart[cluster]; o < clusterStop[cluster]; o++) {
        if (this.mask[o] !== HIDDEN && (inside || boxMeets(frustum, objectBox, 6 * o))) this.add(o, frustum);
      }
    }
    this.addImpostors(frustum);
    return s;
  }

  private add(o: number, frustum: Frustum): void {
    const s = this.selection;
    const { per_pixel } = this.model;
    const level = s.levels[o];
    const triangles = trianglesAt(this.index, o, level);
    let cost = costAt(this.index, o, level);
    if (per_pixel > 0) cost += Math.ceil(per_pixel * boxPixels(frustum, this.index.objectBox, 6 * o, this.width, this.height));
    s.geometryObjects++;
    s.geometryTriangles += triangles;
    s.geometryCost += cost;
    if (this.mask[o] !== SEEN) return;
    s.objects[s.nObjects++] = o;
    s.calls += this.index.objectCalls[o];
    s.triangles += triangles;
    s.cost += cost;
  }

  private addImpostors(frustum: Frustum): void {
    const { chunk, selection: s, model } = this;
    if (!chunk) return;
    for (const m of this.shown) {
      let triangles = 0;
      let pixels = 0;
      for (let row = chunk.impostorLayer[m]; row < chunk.impostorLayer[m + 1]; row++) {
        const first = chunk.layerCorner[row];
        const n = chunk.layerCorner[row + 1] - first;
        triangles += n - 2;
        if (model.per_impostor_pixel > 0) {
          for (let c = 0; c < n; c++) {
            for (let a = 0; a < 3; a++) {
              polygon[3 * c + a] = chunk.impostorEye[3 * m + a] - frustum.eye[a] + chunk.cornerPosition[3 * (first + c) + a];
            }
          }
          pixels += polygonPixels(frustum, polygon, 0, n, this.width, this.height);
        }
      }
      s.triangles += triangles;
      s.cost += Math.ceil(model.per_impostor + model.per_impostor_triangle * triangles + model.per_impostor_pixel * pixels);
    }
  }
}

const polygon = new Float64Array(24);
