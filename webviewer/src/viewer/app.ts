/** The running viewer: one frame after another, drawn only when something has changed. */
import { clampToBoxes } from "../select/clamp";
import { trianglesAt } from "../select/levels";
import { viewsServed, type Placement } from "../placementdb/placement";
import type { Vec3 } from "../placementdb/manifest";
import { lookAheadS } from "../stream/plan";
import type { Traffic } from "../stream/files";
import { Streamer } from "../stream/streamer";
import { byId, setShown, setText } from "../ui/dom";
import { TOGGLE_LETTERS, readShared, sharedFragment } from "../ui/share_link";
import { reasonOf, type FrameFacts } from "../walk/log";
import { Walker } from "./camera";
import { Controls } from "./controls";
import { Difference } from "./difference";
import type { Engine, Modes } from "./engine";
import { readHeat } from "./heat";
import { FrameClock } from "./frame_clock";
import { Overlay, type Counts } from "./overlay";
import { Panorama } from "./panorama";
import { connectToolbar, pressKey, showToolbar } from "./toolbar";
import { Walks } from "./walks";
import { WorstViews, readWorstViews, type WorstView } from "./worst_views";

const OVERLAY_EVERY_MS = 100;
const PLAN_EVERY_MS = 250;
const REST_MS = 300;
const LETTERS: Record<string, keyof Modes> = { i: "impostors", x: "split", b: "beside", l: "layers", m: "heat", c: "cells" };

export type Switches = Partial<Modes & { free: boolean; overlay: boolean; difference: boolean }>;

export class App {
  readonly walker: Walker;
  readonly streamer: Streamer;
  readonly counts: Counts = { promised: 0, over: 0, overForStreaming: 0, incomplete: 0 };
  readonly walks: Walks;
  readonly difference: Difference;
  readonly worst: WorstViews;
  private readonly controls: Controls;
  private readonly clock: FrameClock;
  private readonly overlay: Overlay;
  private readonly panorama: Panorama;
  /** When the first image without stand-ins was there, ms since the page was opened, and what of the placement had come; 0: not yet. */
  firstWholeMs = 0;
  firstWholeBytes = 0;
  /** Resolves when the first image is there as well as it can be: only then more is fetched than it needs. */
  readonly begun: Promise<void>;
  private begin: () => void = () => undefined;
  private dirty = 2; // frames still to draw
  private lastMs = 0;
  private plannedAt = 0;
  private plannedCell = -1;
  private wroteAt = 0;
  private movedAt = 0;
  private panoramaFor = "";
  private readonly facts: FrameFacts = {
    calls: 0, triangles: 0, impostors: 0, waiting: 0, missing: 0, cost: 0, geometryCost: 0, placementMs: 0, cell: -1, problemView: -1, reason: 0,
  };

  constructor(
    readonly engine: Engine,
    readonly placement: Placement,
    private readonly traffic: Traffic,
    readonly canvas: HTMLCanvasElement,
    id: string,
  ) {
    this.walker = new Walker(placement.manifest.view_space);
    this.streamer = new Streamer(placement, engine.pages, () => this.touch(), engine.level, engine.caps.chunks);
    this.streamer.prefetching = false;
    this.begun = new Promise((resolve) => (this.begin = resolve));
    this.clock = new FrameClock(engine.gl);
    this.overlay = new Overlay(engine, this.clock);
    this.panorama = new Panorama(placement);
    this.walks = new Walks(this.walker, this.clock, placement.manifest, id);
    this.difference = new Difference(engine);
    this.worst = new WorstViews(placement.manifest, id, (view) => this.goTo(view));
    this.controls = new Controls(canvas, byId<SVGElement>("stick"), this.walker, {
      key: (key) => pressKey(this, key),
      tap: (x, y) => this.pick(x, y),
      moved: () => {
        this.movedAt = performance.now();
        this.worst.leave();
        this.touch();
      },
    });
    connectToolbar(this);
    new ResizeObserver(() => this.fit()).observe(byId("main"));
    this.fit();
    requestAnimationFrame(this.frame);
  }

  /** Something that the picture shows has changed. */
  touch(): void {
    this.dirty = 2;
  }

  /** Follows a link: view, toggles, held cell and walk, as far as it names them. */
  follow(fragment: string): void {
    const { view, show, cut, held, walk, refused } = readShared(fragment);
    if (view) {
      this.walks.stop();
      this.walker.look(view.position, view.direction);
    }
    if (show !== null) {
      const on = Object.fromEntries(Object.entries(LETTERS).map(([letter, mode]) => [mode, show.includes(letter)]));
      this.setMode({ ...on, difference: show.includes("e"), free: show.includes("g"), freeze: false });
      if (view) this.walker.look(view.position, view.direction); // free flight keeps what the view space does not hold
    }
    if (cut !== null) this.setMode({ splitAt: cut });
    if (held && this.engine.hold(held.cell, held.interval)) this.setMode({ freeze: true });
    if (walk) this.walks.take(walk);
    if (refused) this.walks.say(refused);
    this.touch();
  }

  /** The fragment of a link to what is seen now, with toggles and walk. */
  shared(): string {
    const { modes, situation } = this.engine;
    const on = (letter: string): boolean =>
      letter === "e" ? this.difference.on : letter === "g" ? this.walker.free : Boolean(modes[LETTERS[letter]]);
    return sharedFragment({
      view: { position: [...this.walker.position], direction: [...this.walker.direction] },
      show: [...TOGGLE_LETTERS].filter(on).join(""), cut: modes.split ? modes.splitAt : null,
      held: modes.freeze && situation.cell >= 0 ? { cell: situation.cell, interval: situation.interval } : null, walk: this.walks.walk,
    });
  }

  /** The report's worst views become bookmarks; `report` as parsed, null where there is none. */
  offerWorstViews(report: unknown): void {
    this.worst.show(readWorstViews(report));
  }

  private goTo(view: WorstView): void {
    this.walks.stop();
    this.setMode({ free: false, freeze: false });
    this.walker.look(view.position, view.direction);
    this.touch();
  }

  /** Sizes the canvas: the manifest's aspect, never more pixels than the manifest's, letterboxed in the window. */
  fit(): void {
    const { width, height } = this.placement.manifest.camera;
    const box = byId("main").getBoundingClientRect();
    const scale = Math.min(box.width / width, box.height / height);
    const style = this.canvas.style;
    style.width = `${width * scale}px`;
    style.height = `${height * scale}px`;
    style.left = `${(box.width - width * scale) / 2}px`;
    style.top = `${(box.height - height * scale) / 2}px`;
    Object.assign(byId("difference").style, { width: style.width, height: style.height, left: style.left, top: style.top });
    const share = Math.min(1, scale * devicePixelRatio);
    this.resize(Math.max(1, Math.round(width * share)), Math.max(1, Math.round(height * share)));
    this.placeSplit();
  }

  /** The full size that the guarantee speaks of, for pictures and counts. */
  atFullSize<T>(work: () => T): T {
    const { width, height } = this.placement.manifest.camera;
    const [w, h] = [this.canvas.width, this.canvas.height];
    this.resize(width, height);
    try {
      return work();
    } finally {
      this.resize(w, h);
      this.engine.draw(this.walker.position, this.walker.direction);
    }
  }

  /** Resolves when everything that the present view shows is resident (or known to be damaged) and geometry is there. */
  async settle(): Promise<void> {
    for (;;) {
      this.streamer.upload(Infinity);
      this.locate(true);
      if (this.settledHere()) break;
      await new Promise((resolve) => setTimeout(resolve, 10));
    }
    if (!this.streamer.prefetching) this.draw(); // no frame may have come in between
  }

  private settledHere(): boolean {
    const { engine, placement, streamer } = this;
    const s = engine.situation;
    const chunkHere = s.chunk < 0 || placement.residentChunk(s.chunk) || streamer.damaged.has(placement.manifest.chunks[s.chunk].file);
    return Boolean(engine.level.ready && chunkHere && s.needed.every((p) => streamer.settled(p)) && streamer.levelSettled);
  }

  setMode(modes: Switches): void {
    const { free, overlay, difference, ...rest } = modes;
    if (rest.split) rest.beside = false;
    else if (rest.beside) rest.split = false;
    if (rest.heat) {
      rest.layers = false;
      this.engine.setHeat(readHeat());
    } else if (rest.layers) rest.heat = false;
    Object.assign(this.engine.modes, rest);
    if (rest.freeze) this.engine.showHeld();
    if (difference !== undefined) this.difference.set(difference);
    if (free !== undefined) this.walker.setFree(free);
    if (overlay !== undefined) {
      for (const e of document.querySelectorAll<HTMLElement>(".overlay:not(#picked)")) e.hidden = !overlay;
      if (!overlay) setShown("picked", false); // shown again only for what is picked again
    }
    showToolbar(this);
    setShown("heat", this.engine.modes.heat);
    if (!this.engine.modes.layers && !this.engine.modes.heat) setShown("picked", false);
    this.placeSplit();
    this.touch();
  }

  private readonly frame = (now: number): void => {
    requestAnimationFrame(this.frame);
    const seconds = Math.min(0.1, (now - this.lastMs) / 1000);
    this.lastMs = now;
    this.clock.collect();
    if (this.walks.replaying) {
      this.movedAt = now;
      this.touch();
    } else if (this.controls.advance(seconds)) {
      this.movedAt = now;
      this.worst.leave();
      this.touch();
    }
    this.walks.advance(now);
    const began = performance.now();
    this.streamer.upload(1);
    if (this.locate(now - this.plannedAt > PLAN_EVERY_MS)) this.touch();
    this.engine.placementMs = performance.now() - began;
    if (this.dirty > 0) {
      this.dirty--;
      this.draw();
      this.difference.clear();
    }
    if (now - this.wroteAt > OVERLAY_EVERY_MS) {
      this.wroteAt = now;
      this.overlay.write(this.counts, this.streamer, this.traffic);
      this.overlay.writeHeading(this.walker.yaw);
      this.writeOutside();
      if (this.walks.recording || this.walks.replaying) this.walks.write();
      if (now - this.movedAt > REST_MS) this.lookAround();
    }
  };

  private draw(): void {
    const { engine, clock } = this;
    clock.begin();
    engine.draw(this.walker.position, this.walker.direction);
    const s = engine.selection;
    // Without impostors, with a held cell or outside the view space nothing is promised: those frames count as neither.
    const promised = engine.modes.impostors && !engine.modes.freeze && engine.situation.cell >= 0;
    const over = promised && s.cost > this.placement.manifest.budget.amount;
    const late = over && engine.situation.waiting;
    if (promised) this.counts.promised++;
    if (over) this.counts.over++;
    if (late) this.counts.overForStreaming++;
    if (engine.standIns.missing || engine.standIns.untextured) this.counts.incomplete++;
    else if (!this.firstWholeMs && engine.level.ready) this.noteFirst();
    clock.end(s.cost, s.geometryCost, late);
    if (!this.streamer.prefetching && this.settledHere()) {
      this.streamer.prefetching = true;
      this.plannedAt = -Infinity; // the next frame plans
      this.begin();
    }
    if (this.walks.replaying) this.tellWalk(promised);
  }

  private noteFirst(): void {
    this.firstWholeBytes = this.traffic.bytes;
    this.engine.gl.finish(); // the time of the picture, not of its commands
    this.firstWholeMs = performance.now();
  }

  private tellWalk(promised: boolean): void {
    const { facts: f, engine } = this;
    const { selection: s, situation, drawn } = engine;
    f.calls = drawn.calls;
    f.triangles = drawn.triangles;
    f.impostors = engine.modes.impostors ? situation.shown.length : 0;
    f.waiting = situation.impostors - situation.shown.length;
    f.missing = engine.standIns.missing;
    f.cost = s.cost;
    f.geometryCost = s.geometryCost;
    f.placementMs = engine.placementMs;
    f.cell = situation.cell;
    f.problemView = situation.problemView ?? -1;
    f.reason = reasonOf(s.cost > this.placement.manifest.budget.amount, promised, situation.hopeless, situation.waiting);
    this.walks.drawn(f);
  }

  private locate(replan: boolean): boolean {
    const { position, velocity } = this.walker;
    const changed = this.engine.locate(position, this.walker.direction);
    const { situation, standIns } = this.engine;
    // Where the view lacks nothing, turning on the spot needs no new plan before the next is due.
    const due = replan || (changed && (situation.waiting || standIns.missing > 0 || situation.cell !== this.plannedCell));
    if (due && !this.streamer.whole) {
      this.plannedAt = this.lastMs;
      this.plannedCell = situation.cell;
      const seconds = lookAheadS(this.traffic.fileS);
      const ahead = position.map((x, a) => x + seconds * velocity[a]);
      const { engine } = this;
      const parts = engine.wantedParts(position, this.walker.direction, ahead);
      const likely = engine.likelyPages(this.walker.direction, ahead);
      this.streamer.update(engine.situation.chunk, likely, ahead, parts, new Set(engine.situation.needed).size);
    }
    return changed;
  }

  private lookAround(): void {
    const { position, direction, pitch } = this.walker;
    if (this.difference.on && this.engine.level.ready && !this.engine.situation.waiting) {
      const { width, height } = this.canvas;
      const key = `${position} ${direction} ${width} ${height} ${this.engine.version}`;
      if (this.difference.rest(key, position, direction)) this.engine.draw(position, direction);
    }
    const key = `${position} ${pitch} ${this.placement.residentChunk(this.engine.situation.chunk) ? 1 : 0}`;
    if (key === this.panoramaFor) return;
    this.panoramaFor = key;
    if (this.panorama.update(position, pitch)) this.overlay.writePanorama(this.panorama, this.walker.yaw);
  }

  private writeOutside(): void {
    const { walker, engine } = this;
    const lost = walker.free && !walker.inside;
    let why = "";
    if (lost) {
      const nearest: Vec3 = [0, 0, 0];
      clampToBoxes(this.placement.manifest.view_space, walker.position, nearest);
      const far = Math.hypot(...nearest.map((x, a) => x - walker.position[a]));
      why = `Free flight: ${far < 10 ? far.toFixed(1) : far.toFixed(0)} m outside the view space.`;
    } else if (engine.modes.freeze) {
      why = `Cell ${engine.situation.cell} and its interval are held.`;
    }
    setShown("outside", why !== "");
    setText("outside-why", why);
    setText("outside-key", lost ? "G" : "F");
  }

  /** Names the impostor at a point of the picture, (0, 0) its top left, where layers or texels are shown. */
  pick(x: number, y: number): void {
    if (!this.engine.modes.layers && !this.engine.modes.heat) return;
    const { width, height } = this.canvas;
    const ids = this.engine.drawIds(this.walker.position, this.walker.direction);
    this.engine.draw(this.walker.position, this.walker.direction);
    const at = 4 * (Math.min(height - 1, Math.floor((1 - y) * height)) * width + Math.min(width - 1, Math.floor(x * width)));
    const id = (ids[at] | (ids[at + 1] << 8) | (ids[at + 2] << 16)) - 1;
    this.engine.showPicked(id);
    this.touch();
    if (id < 0) return setShown("picked", false);
    const { index, manifest } = this.placement;
    const cluster = index.impostorCluster[id];
    let far = 0;
    for (let a = 0; a < 3; a++) {
      const p = this.walker.position[a] - manifest.origin_m[a];
      far += Math.max(index.clusterBox[6 * cluster + a] - p, p - index.clusterBox[6 * cluster + 3 + a], 0) ** 2;
    }
    let triangles = 0;
    const { levels } = this.engine.selection;
    for (let o = index.clusterStart[cluster]; o < index.clusterStop[cluster]; o++) triangles += trianglesAt(index, o, levels[o]);
    this.overlay.writePicked(id, index, levels, Math.sqrt(far), triangles, viewsServed(this.placement, id));
  }

  async copyLink(): Promise<void> {
    history.replaceState(null, "", this.shared());
    const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
    this.walks.say(copied ? "Link copied: it holds view, toggles and walk." : "The address now holds view, toggles and walk: copy it.");
  }

  private placeSplit(): void {
    const { split, splitAt } = this.engine.modes;
    setShown("split", split);
    const style = this.canvas.style;
    byId("split").style.left = `${Number.parseFloat(style.left) + splitAt * Number.parseFloat(style.width)}px`;
    byId("split").setAttribute("aria-valuenow", String(Math.round(100 * splitAt)));
  }

  private resize(width: number, height: number): void {
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.touch();
  }
}
