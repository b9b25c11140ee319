/**
 * From a camera to a picture: where it is, what that shows, what of it is resident, and the draw calls.
 *
 * Until an impostor's pages are resident its objects are drawn as geometry: never a hole, and the frame is counted when that
 * puts it over budget.
 */
import { CellLines } from "../draw/draw_cells";
import { ImpostorLayers, type DrawStats } from "../draw/draw_impostor_layers";
import { Boxes } from "../draw/draw_boxes";
import { LevelMesh } from "../draw/draw_mesh";
import { WireLines } from "../draw/draw_wires";
import { HEAT, IDS, PICTURE, TINTED, farthest, makeView, setViewProjection, type View } from "../draw/view";
import { heldWires, impostorWires } from "../draw/wires";
import { ChunkBuffers } from "../gl/chunk_buffers";
import { PageArray } from "../gl/page_array";
import { PictureTarget } from "../gl/picture_target";
import { chunkOfCell, impostorsOfView, viewInChunk, visibleOfCell, type Placement } from "../placementdb/placement";
import type { PlacementChunk } from "../placementdb/chunk";
import type { Vec3 } from "../placementdb/manifest";
import { findCell } from "../select/cells";
import { cameraFrame, makeFrustum, setFrustum } from "../select/frustum";
import { findInterval } from "../select/intervals";
import { Selector, type Selection } from "../select/select";
import { capsOf, type Caps } from "../stream/caps";
import { LevelPlan, type PartsWanted } from "../stream/level_plan";
import { ChunkPages } from "../stream/plan";
import { bytesPerMetre } from "../stream/speed";

/** Linear light of an encoded value, 0 to 1. */
const decodeSrgb = (x: number): number => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);

const NEAR_M = 0.1;
const BLACK: Modes["background"] = [0, 0, 0];
const SHAFT_M = 200; // of a shaft without end, as a wire frame
const INTERVAL_M = 40;

export interface Modes {
  impostors: boolean;
  layers: boolean;
  heat: boolean; // texels a pixel
  cells: boolean;
  split: boolean; // swipe: one picture, geometry right of the divider
  beside: boolean; // side by side: the middle half of the picture twice, geometry on the right
  freeze: boolean;
  splitAt: number; // share of the width that shows impostors
  background: [number, number, number]; // sRGB, 0 to 1
}

/** What the current position and direction show. */
export interface Situation {
  cell: number; // -1: outside the view space
  interval: number;
  chunk: number; // -1: the cell is in none
  problemView: number | null;
  hopeless: boolean;
  costBound: number;
  impostors: number; // that the placement shows here
  shown: number[]; // of them resident: local impostors of the chunk
  needed: number[]; // pages
  waiting: boolean; // something of the current view is still on its way
}

/** How the last frame stood in for geometry that is not here. */
export interface StandIns {
  missing: number; // objects drawn at another level of detail, or as boxes
  boxes: number; // of them
  untextured: number; // primitives drawn in the mean colour of their texture
}

export class Engine {
  readonly placement: Placement;
  readonly gl: WebGL2RenderingContext;
  readonly pages: PageArray;
  readonly level: LevelMesh;
  readonly modes: Modes = {
    impostors: true, layers: false, heat: false, cells: false, split: false, beside: false, freeze: false, splitAt: 0.5, background: [0.62, 0.74, 0.82],
  };
  readonly situation: Situation = {
    cell: -1, interval: -1, chunk: -1, problemView: null, hopeless: false, costBound: 0, impostors: 0, shown: [], needed: [], waiting: true,
  };
  readonly drawn: DrawStats = { calls: 0, triangles: 0 };
  readonly standIns: StandIns = { missing: 0, boxes: 0, untextured: 0 };
  levelPlan: LevelPlan | null = null; // where the level is in pages
  /** What finding and submitting impostors, and choosing what is drawn, took of the processor since it was last set to 0. */
  placementMs = 0;
  /** Rises whenever what a view shows may have changed. */
  version = 0;
  readonly view: View = makeView();
  selection: Selection;
  private readonly target: PictureTarget;
  private readonly layers: ImpostorLayers;
  private readonly selector: Selector;
  private readonly geometry: Selector;
  private readonly frustum = makeFrustum();
  private readonly buffers = new Map<PlacementChunk, ChunkBuffers>();
  private readonly chunkPages = new WeakMap<PlacementChunk, ChunkPages>();
  private readonly boxes: Boxes;
  private readonly covered: Uint8Array; // by object: impostors of the view show it, once they are here
  private readonly cellLines: CellLines;
  private readonly pickedLines: WireLines;
  private readonly heldLines: WireLines;
  private readonly locatedFor = new Float64Array(5).fill(NaN);
  private readonly canvas: HTMLCanvasElement;
  private readonly local: Vec3 = [0, 0, 0];

  constructor(canvas: HTMLCanvasElement, gl: WebGL2RenderingContext, placement: Placement, readonly caps: Caps = capsOf(placement.manifest, null)) {
    this.canvas = canvas;
    this.gl = gl;
    this.placement = placement;
    const { manifest, index } = placement;
    this.level = new LevelMesh(canvas, gl, manifest);
    this.pages = new PageArray(gl, manifest, caps.pages);
    this.target = new PictureTarget(gl);
    this.layers = new ImpostorLayers(gl);
    this.boxes = new Boxes(gl, this.level.lighting);
    this.covered = new Uint8Array(manifest.counts.objects);
    this.cellLines = new CellLines(gl, index);
    this.pickedLines = new WireLines(gl, this.cellLines.program, [0.58, 0.32, 0, 1]);
    this.heldLines = new WireLines(gl, this.cellLines.program, [0, 0.12, 0.15, 1]);
    this.selector = new Selector(index, manifest);
    this.geometry = new Selector(index, manifest);
    this.selection = this.selector.selection;
  }

  /** Fetches which mesh each object shows, and gets ready for their pages; only where the level is in pages. */
  async openLevel(): Promise<void> {
    const index = await this.placement.geometry();
    this.level.open(this.placement.manifest, index, this.caps.level);
    this.levelPlan = new LevelPlan(index, this.placement.manifest.geometry!, this.placement.index.objectBox);
  }

  /** Finds cell, interval and impostors of the view; returns whether anything changed. */
  locate(position: ArrayLike<number>, direction: ArrayLike<number>): boolean {
    const { manifest, index } = this.placement;
    const s = this.situation;
    if (!this.modes.freeze) {
      s.cell = findCell(index, manifest, position);
      s.interval = findInterval(manifest.interval_edges, direction);
      s.chunk = s.cell < 0 ? -1 : chunkOfCell(manifest, s.cell);
    }
    const chunk = s.chunk < 0 ? null : (this.placement.residentChunk(s.chunk) ?? null);
    const was = this.locatedFor;
    const number = chunk ? chunk.number : -1;
    const impostors = this.modes.impostors ? 1 : 0;
    if (was[0] === s.cell && was[1] === s.interval && was[2] === number && was[3] === this.pages.version && was[4] === impostors) return false;
    was[0] = s.cell;
    was[1] = s.interval;
    was[2] = number;
    was[3] = this.pages.version;
    was[4] = impostors;
    this.version++;
    const view = chunk && s.cell >= 0 ? viewInChunk(chunk, s.cell, s.interval) : -1;
    const list = chunk && view >= 0 ? impostorsOfView(chunk, view) : [];
    s.impostors = list.length;
    s.problemView = chunk && view >= 0 ? chunk.views[0] + view : null;
    s.hopeless = chunk !== null && view >= 0 && chunk.viewHopeless[view] !== 0;
    s.costBound = manifest.cost_model.per_frame + (chunk && view >= 0 ? chunk.viewCost[view] : manifest.worst_nonproblem);
    s.needed = [];
    s.shown = [];
    this.covered.fill(0);
    for (const m of list) {
      const cluster = index.impostorCluster[chunk!.impostorId[m]];
      if (this.modes.impostors) this.covered.fill(1, index.clusterStart[cluster], index.clusterStop[cluster]);
      const pages = this.pagesOf(chunk!).of(m);
      s.needed.push(...pages);
      if (pages.every((page) => this.pages.isResident(page))) s.shown.push(m);
    }
    s.waiting = (s.chunk >= 0 && !chunk) || s.shown.length < s.impostors;
    for (const page of s.needed) this.pages.touch(page);
    const shown = this.modes.impostors ? s.shown : [];
    const visible = s.cell < 0 ? null : visibleOfCell(chunk, s.cell);
    this.selector.setView(s.cell, visible, chunk, shown);
    this.geometry.setView(s.cell, visible, null, []);
    this.layers.setShown(chunk && shown.length ? this.buffersOf(chunk) : null, shown);
    return true;
  }

  /** Takes a cell and interval as if the camera stood there, to be held; false where there are none such. */
  hold(cell: number, interval: number): boolean {
    const { manifest } = this.placement;
    if (cell >= manifest.counts.cells || interval >= 6 * (manifest.interval_edges.length - 1) ** 2) return false;
    this.situation.cell = cell;
    this.situation.interval = interval;
    this.situation.chunk = chunkOfCell(manifest, cell);
    return true;
  }

  /** Shows the view cell of an impostor, and what it replaces, as wire frames; -1: of none. */
  showPicked(id: number): void {
    this.pickedLines.set(id < 0 ? null : impostorWires(this.placement.index, id, SHAFT_M));
  }

  /** Shows the held cell and its interval while `modes.freeze` is on. */
  showHeld(): void {
    const { cell, interval } = this.situation;
    const { interval_edges } = this.placement.manifest;
    this.heldLines.set(cell < 0 || interval < 0 ? null : heldWires(this.placement.index, cell, interval, interval_edges, INTERVAL_M));
  }

  /** Pages that are likely to be needed, best first: this view, turning on the spot, the cell ahead. */
  likelyPages(direction: ArrayLike<number>, ahead: ArrayLike<number>): Set<number> {
    const { manifest, index } = this.placement;
    const s = this.situation;
    const out = new Set(s.needed);
    const next = findCell(index, manifest, ahead);
    for (const cell of next === s.cell ? [s.cell] : [s.cell, next]) {
      const number = cell < 0 ? -1 : chunkOfCell(manifest, cell);
      const chunk = number < 0 ? undefined : this.placement.residentChunk(number);
      if (chunk) this.pagesOf(chunk).addCell(cell, direction, manifest.interval_edges, out);
    }
    return out;
  }

  /** Parts of the level that are wanted, best first: this view, this cell, and what is near where the camera will be. */
  wantedParts(position: Vec3, direction: Vec3, ahead: ArrayLike<number>): PartsWanted | undefined {
    const { level, levelPlan, placement, situation: s } = this;
    if (!levelPlan || !level.pages) return undefined;
    this.prepare(position, direction);
    const chunk = s.chunk < 0 ? null : (placement.residentChunk(s.chunk) ?? null);
    const visible = s.cell < 0 ? null : visibleOfCell(chunk, s.cell);
    const { origin_m } = placement.manifest;
    const from = [0, 1, 2].map((a) => ahead[a] - origin_m[a]);
    const { objects, nObjects, levels } = this.selection;
    return levelPlan.wanted(objects, nObjects, this.covered, visible, levels, from, level.pages.partBytes, this.caps.level);
  }

  /** The most bytes that a metre of walking asks for, in the cells around; 0: not known. */
  bytesPerMetre(): number {
    const { placement, situation: s } = this;
    const chunk = s.chunk < 0 ? undefined : placement.residentChunk(s.chunk);
    return chunk ? bytesPerMetre(placement.manifest, placement.index, chunk, this.pagesOf(chunk), this.levelPlan) : 0;
  }

  /** Draws one frame into the canvas at its present size. */
  draw(position: Vec3, direction: Vec3): void {
    const began = performance.now();
    this.prepare(position, direction);
    this.placementMs += performance.now() - began;
    const { gl, modes } = this;
    const { width, height } = this.canvas;
    this.view.mode = modes.heat ? HEAT : modes.layers ? TINTED : PICTURE;
    this.bind();
    this.clear(modes.background);
    this.drawn.calls = this.drawn.triangles = 0;
    const compared = modes.split || modes.beside;
    const cut = modes.beside ? width >> 1 : Math.round(width * modes.splitAt);
    const shift = modes.beside ? Math.round(width / 4) : 0;
    this.drawSide(this.selection, true, 0, compared ? cut : width, -shift);
    if (compared) {
      const { calls, triangles } = this.drawn;
      this.drawSide(this.geometry.select(this.frustum), false, cut, width, shift);
      this.drawn.calls = calls;
      this.drawn.triangles = triangles;
    }
    gl.disable(gl.SCISSOR_TEST);
    if (modes.beside) gl.enable(gl.SCISSOR_TEST);
    for (let side = 0; side < (modes.beside ? 2 : 1); side++) {
      gl.viewport(side ? shift : -shift, 0, width, height);
      gl.scissor(side ? cut : 0, 0, side ? width - cut : cut, height);
      if (modes.cells) this.cellLines.draw(this.view, this.placement.manifest.origin_m, this.situation.cell);
      if (modes.freeze) this.heldLines.draw(this.view, this.placement.manifest.origin_m);
      if (modes.layers || modes.heat) this.pickedLines.draw(this.view, this.placement.manifest.origin_m);
    }
    this.target.show();
  }

  /** Colours of the classes of texels a pixel, sRGB, 0 to 1. */
  setHeat(colors: readonly (readonly number[])[]): void {
    colors.forEach((color, k) => color.forEach((x, a) => (this.layers.heat[3 * k + a] = decodeSrgb(x))));
  }

  /** Draws impostor ids (+ 1) as colours, everything else black, and returns the pixels (RGBA, bottom row first). */
  drawIds(position: Vec3, direction: Vec3): Uint8Array {
    this.prepare(position, direction);
    this.view.mode = IDS;
    this.bind();
    this.clear(BLACK);
    this.drawSide(this.selection, true, 0, this.canvas.width);
    return this.pixels();
  }

  /** Draws the plain picture, with impostors or geometry alone, into the canvas; returns it (RGBA, bottom row first). */
  drawPlain(position: Vec3, direction: Vec3, impostors: boolean): Uint8Array {
    this.prepare(position, direction);
    this.view.mode = PICTURE;
    this.bind();
    this.clear(this.modes.background);
    this.drawSide(impostors ? this.selection : this.geometry.select(this.frustum), impostors, 0, this.canvas.width);
    this.target.show();
    return this.pixels();
  }

  /** What the canvas shows (RGBA, bottom row first). */
  private pixels(): Uint8Array {
    const { gl } = this;
    const { width, height } = this.canvas;
    const out = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return out;
  }

  private prepare(position: Vec3, direction: Vec3): void {
    const { manifest } = this.placement;
    const { fov_deg, width, height } = manifest.camera;
    const { view, frustum, local } = this;
    cameraFrame(position, direction, view.frame);
    setFrustum(frustum, view.frame, fov_deg, width / height);
    for (let a = 0; a < 3; a++) local[a] = position[a] - manifest.origin_m[a];
    frustum.eye = local;
    view.tanX = frustum.tanX;
    view.tanY = frustum.tanY;
    view.near = NEAR_M;
    view.far = farthest(position, manifest.bounds);
    setViewProjection(view);
    this.selection = this.selector.select(frustum);
  }

  /** Binds what is drawn into: the canvas itself for ids, which must not be averaged. */
  private bind(): void {
    if (this.view.mode === IDS) this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, null);
    else this.target.bind(this.canvas.width, this.canvas.height);
  }

  private clear(color: Modes["background"]): void {
    const { gl } = this;
    gl.disable(gl.SCISSOR_TEST);
    gl.colorMask(true, true, true, true);
    gl.depthMask(true);
    gl.clearColor(decodeSrgb(color[0]), decodeSrgb(color[1]), decodeSrgb(color[2]), 1);
    gl.clearDepth(1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  /** Columns `from` to `to` of the picture, which is moved to the right by `shift` pixels. */
  private drawSide(selection: Selection, withImpostors: boolean, from: number, to: number, shift = 0): void {
    const { gl, view, level } = this;
    const { width, height } = this.canvas;
    if (withImpostors) {
      gl.viewport(shift, 0, width, height);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(from, 0, to - from, height);
      // Impostors first: blended geometry must come over them.
      const began = performance.now();
      this.layers.draw(view, this.pages, this.placement.manifest.origin_m, this.drawn);
      this.placementMs += performance.now() - began;
    }
    const { renderer } = level;
    renderer.resetState();
    this.bind();
    renderer.setViewport(shift, 0, width, height);
    renderer.setScissorTest(true);
    renderer.setScissor(from, 0, to - from, height);
    if (!level.ready) return;
    level.draw(view, selection, this.drawn);
    if (withImpostors) {
      this.standIns.missing = level.missing;
      this.standIns.boxes = level.nAbsent;
      this.standIns.untextured = level.untextured;
    }
    if (!level.nAbsent) return;
    renderer.resetState();
    this.bind();
    gl.viewport(shift, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, to - from, height);
    const { manifest, index } = this.placement;
    this.boxes.draw(view, manifest.origin_m, level.absent, level.nAbsent, index.objectBox, level.geometry!.objectColor, this.drawn);
  }

  private pagesOf(chunk: PlacementChunk): ChunkPages {
    let pages = this.chunkPages.get(chunk);
    if (!pages) this.chunkPages.set(chunk, (pages = new ChunkPages(chunk)));
    return pages;
  }

  private buffersOf(chunk: PlacementChunk): ChunkBuffers {
    let buffers = this.buffers.get(chunk);
    if (!buffers) {
      const { origin_m, chunks } = this.placement.manifest;
      const [low, high] = chunks[chunk.number].box;
      const anchor = [0, 1, 2].map((a) => (low[a] + high[a]) / 2 - origin_m[a]) as Vec3;
      buffers = new ChunkBuffers(this.gl, chunk, anchor, this.layers.indexBuffer);
      this.buffers.set(chunk, buffers);
    }
    // Chunks that the streamer has dropped take their buffers with them.
    for (const [other, old] of this.buffers) {
      if (other !== chunk && this.placement.residentChunk(other.number) !== other) {
        old.dispose();
        this.buffers.delete(other);
      }
    }
    return buffers;
  }
}
