/** Writes the overlay: numbers ten times a second, plots from the frame clock, states. */
import type { PlacementIndex } from "../placementdb/index_file";
import type { Manifest } from "../placementdb/manifest";
import type { Served } from "../placementdb/placement";
import { intervalName } from "../select/intervals";
import { costAt } from "../select/levels";
import { heldBytes } from "../stream/caps";
import { bandwidth, type Traffic } from "../stream/files";
import type { Streamer } from "../stream/streamer";
import { byId, setShown, setText } from "../ui/dom";
import { bytes, cost, count, short, tick } from "../ui/format";
import type { Engine } from "./engine";
import { FRAMES_KEPT, type FrameClock } from "./frame_clock";
import { DIRECTIONS, type Panorama } from "./panorama";

const LEFT = 34; // room for "2,612"
const RIGHT = 250;

export interface Counts {
  overForStreaming: number; // frames over budget because impostors were not here yet
  over: number; // frames over budget for any reason
  incomplete: number; // frames with boxes or coarse levels in place of geometry that was not here yet
  promised: number; // frames that the guarantee speaks of
}

export class Overlay {
  private readonly engine: Engine;
  private readonly clock: FrameClock;
  private readonly manifest: Manifest;
  private rateBytes = 0;
  private rateAt = 0;
  private rate = 0;
  private speedFor = -2;
  private perMetre = 0;

  constructor(engine: Engine, clock: FrameClock) {
    this.engine = engine;
    this.clock = clock;
    this.manifest = engine.placement.manifest;
    const { budget, interval_edges, verdict } = this.manifest;
    const degrees = 90 / (interval_edges.length - 1);
    setText("interval-label", `Interval, ${degrees}°`);
    setText("ms-of", budget.unit === "ns" ? ` of ${(budget.amount / 1e6).toFixed(1)}` : "");
    setText("verdict", `${verdict}; ${plural(this.manifest.counts.impostors)}, ${bytes(this.manifest.bytes)}`);
  }

  write(counts: Counts, streamer: Streamer, traffic: Traffic): void {
    const { engine, clock, manifest } = this;
    const { selection, situation: s, pages } = engine;
    const { budget } = manifest;
    setText("ms", clock.median()?.toFixed(1) ?? "–"); // unknown until the GPU's timer tells
    byId("ms").title = clock.source;
    const named = cost(selection.cost, budget.unit);
    setText("cost", budget.unit === "ns" ? `predicted ${named}` : `${count(selection.cost)} of ${cost(budget.amount, budget.unit)}`);
    byId("cost").classList.toggle("over", selection.cost > budget.amount);
    setText("late", `${count(counts.over)} over of ${count(counts.promised)}`);
    setText("calls", count(engine.drawn.calls));
    setText("triangles", short(engine.drawn.triangles));
    setText("resident", ((pages.residentPages * pages.bytesPerPage + (engine.level.pages?.bytes ?? 0)) / 1e6).toFixed(1));
    setText("resident-of", `of ${((Math.min(pages.slots, manifest.pages.length) * pages.bytesPerPage + this.levelBytes()) / 1e6).toFixed(0)} MB`);
    setText("cell", s.cell < 0 ? "outside" : String(s.cell));
    setText("interval", intervalName(s.interval, manifest.interval_edges.length - 1));
    const used = engine.modes.impostors ? s.shown.length : 0;
    setText("impostors", used === s.impostors ? String(used) : `${used} of ${s.impostors}`);
    this.writeStreaming(counts, streamer, traffic);
    this.plot();
  }

  private writeStreaming(counts: Counts, streamer: Streamer, traffic: Traffic): void {
    const { engine, manifest } = this;
    const now = performance.now();
    if (now - this.rateAt > 1000) {
      this.rate = this.rateAt ? ((traffic.bytes - this.rateBytes) * 1000) / (now - this.rateAt) : 0;
      this.rateBytes = traffic.bytes;
      this.rateAt = now;
    }
    const level = engine.level.pages;
    const all = manifest.pages.length + (level?.parts ?? 0);
    const resident = engine.pages.residentPages + (level?.resident ?? 0);
    const complete = streamer.complete;
    const lost = traffic.failures >= 2;
    setText("stream-state", lost ? "connection lost" : complete ? (streamer.whole ? "all resident" : "complete here") : "streaming");
    byId("stream-icon").setAttribute("href", lost ? "#warn" : complete ? "#done" : "#run");
    setText("in-flight", complete ? "" : `${streamer.inFlight} in flight`);
    const share = all ? resident / Math.min(all, engine.pages.slots + (level?.parts ?? 0)) : 1;
    (byId("stream-bar").firstElementChild as HTMLElement).style.width = `${100 * share}%`;
    byId("stream-bar").setAttribute("aria-valuenow", String(Math.round(100 * share)));
    setText("this-cell", engine.situation.waiting || engine.standIns.missing ? "this view is on its way" : "this view complete");
    setText("rate", this.rate > 0 && !complete ? `${bytes(this.rate)}/s` : "");
    setText("stream-late", `${count(counts.overForStreaming)} frames over budget while loading, ${count(counts.incomplete)} with stand-ins`);
    setText("stream-speed", this.speedWords(streamer, traffic));
    if (lost) {
      const seconds = Math.max(0, Math.ceil((traffic.retryAtMs - now) / 1000));
      notice("inf", "Connection lost", `What is here stays usable. Trying again in ${seconds} s.`);
    } else if (traffic.offline) {
      notice("inf", "The service does not answer", "This is what this browser kept of the placement. What it did not keep stays boxes or geometry.");
    } else if (streamer.denied) {
      notice("bad", "Access ended", streamer.denied.message);
    } else if (streamer.damaged.size) {
      const [first] = streamer.damaged.values();
      const more = streamer.damaged.size > 1 ? ` ${streamer.damaged.size - 1} more files likewise.` : "";
      notice("bad", "Placement damaged", `${first}${more} What it holds is drawn as geometry. Fetch or place the level again.`);
    } else if (!failed) {
      setShown("notice", false);
    }
  }

  /** Of the level in video memory: what it would take, or may. */
  private levelBytes(): number {
    return Math.min(this.engine.caps.level, heldBytes(this.manifest).level);
  }

  private speedWords(streamer: Streamer, traffic: Traffic): string {
    const { chunk } = this.engine.situation;
    if (streamer.whole) return "all of it is here: no limit of speed";
    if (chunk !== this.speedFor) {
      this.speedFor = chunk;
      this.perMetre = this.engine.bytesPerMetre();
    }
    const rate = bandwidth(traffic);
    if (!rate || !this.perMetre) return "";
    const speed = rate / this.perMetre;
    return `${bytes(rate)}/s keep the budget up to ${speed < 10 ? speed.toFixed(1) : speed.toFixed(0)} m/s here`;
  }

  private plot(): void {
    const { clock, manifest } = this;
    const { budget } = manifest;
    const time = budget.unit === "ns";
    const scale = time ? 1e6 : 1;
    const limit = budget.amount / scale;
    const n = Math.min(clock.frames, FRAMES_KEPT);
    let top = limit * 1.2;
    const at = (k: number): number => (clock.frames - n + k) % FRAMES_KEPT;
    for (let k = 0; k < n; k++) top = Math.max(top, time ? clock.ms[at(k)] : Math.max(clock.cost[at(k)], clock.geometryCost[at(k)]));
    top = Math.min(top, limit * 4);
    const x = (k: number): number => LEFT + ((RIGHT - LEFT) * (k + FRAMES_KEPT - n)) / (FRAMES_KEPT - 1);
    const y = (v: number): number => 82 - 76 * Math.min(1, v / top);
    const path = (value: (i: number) => number): string => {
      let d = "";
      for (let k = 0; k < n; k++) d += `${k ? "L" : "M"}${x(k).toFixed(1)} ${y(value(at(k))).toFixed(1)}`;
      return d;
    };
    byId("plot-line").setAttribute("d", path((i) => (time ? clock.ms[i] : clock.cost[i])));
    byId("plot-predicted").setAttribute("d", path((i) => (time ? clock.cost[i] / 1e6 : clock.geometryCost[i])));
    byId("plot-budget").setAttribute("d", `M${LEFT} ${y(limit)}H${RIGHT}`);
    byId("plot-over").setAttribute("height", String(Math.max(0, y(limit) - 6)));
    let late = "";
    for (let k = 0; k < n; k++) if (clock.late[at(k)]) late += `M${x(k).toFixed(1)} 6v7`;
    byId("plot-late").setAttribute("d", late);
    setText("plot-top", tick(top));
    byId("plot-label").setAttribute("y", String(y(limit) + 4));
    setText("plot-label", tick(limit));
  }

  writePanorama(panorama: Panorama, yaw: number): void {
    const { budget } = this.manifest;
    let top = budget.amount;
    for (let k = 0; k < DIRECTIONS; k++) top = Math.max(top, panorama.cost[k], panorama.geometryCost[k]);
    const x = (k: number): number => LEFT + ((RIGHT - LEFT) * k) / DIRECTIONS;
    const y = (v: number): number => 66 - (60 * v) / (1.05 * top);
    const path = (values: Float64Array): string => {
      let d = "";
      for (let k = 0; k <= DIRECTIONS; k++) d += `${k ? "L" : "M"}${x(k).toFixed(1)} ${y(values[k % DIRECTIONS]).toFixed(1)}`;
      return d;
    };
    byId("around-cost").setAttribute("d", path(panorama.cost));
    byId("around-geometry").setAttribute("d", path(panorama.geometryCost));
    byId("around-budget").setAttribute("d", `M${LEFT} ${y(budget.amount)}H${RIGHT}`);
    setText("around-top", tick(budget.unit === "ns" ? top / 1e6 : top));
    const group = byId<SVGGElement>("around-problem");
    const marks = Array.from(panorama.problem, (p, k) => (p ? `M${(x(k) - 1.77).toFixed(1)} 6h3.53v60h-3.53z` : "")).join("");
    if (!group.firstChild) group.append(document.createElementNS("http://www.w3.org/2000/svg", "path"));
    (group.firstChild as SVGPathElement).setAttribute("class", "fillO");
    (group.firstChild as SVGPathElement).setAttribute("d", marks);
    this.writeHeading(yaw);
  }

  writeHeading(yaw: number): void {
    const turn = (((-yaw / (2 * Math.PI)) % 1) + 1) % 1;
    const x = LEFT + (RIGHT - LEFT) * turn;
    byId("around-marker").setAttribute("d", `M${x - 4} 2h8l-4 6zM${x - 0.4} 6h.8v60h-.8z`);
  }

  writePicked(id: number, index: PlacementIndex, levels: Uint8Array, distanceM: number, triangles: number, served: Served): void {
    const { budget } = this.manifest;
    const cluster = index.impostorCluster[id];
    const [a, b] = [index.clusterStart[cluster], index.clusterStop[cluster]];
    let saved = -index.impostorCost[id];
    for (let o = a; o < b; o++) saved += costAt(index, o, levels[o]);
    setText("picked-id", `#${count(id)}`);
    setText("picked-far", `${distanceM.toFixed(0)} m away`);
    setText("picked-replaces", `${count(b - a)} objects, ${count(triangles)} triangles`);
    setText("picked-layers", `${index.impostorLayers[id]}, ${bytes(index.impostorBytes[id])}`);
    setText("picked-valid", index.impostorKind[id] === 0 ? "a shaft" : "a box of cells");
    setText("picked-serves", `${count(served.views)} problem views${served.all ? "" : " of those loaded"}`);
    setText("picked-error", `at most ${this.manifest.quality.pixel_error} px`);
    setText("picked-saves", `about ${cost(Math.max(0, saved), budget.unit)}`);
    setShown("picked", true);
  }
}

function plural(impostors: number): string {
  return `${count(impostors)} impostor${impostors === 1 ? "" : "s"}`;
}

let failed = false;

/** A note that stays: the viewer cannot go on, and what it writes about streaming must not cover that up. */
export function failure(title: string, text: string): void {
  notice("bad", title, text);
  failed = true;
}

/** The note above the toolbar; kind as in the stylesheet ("inf" warns, "bad" fails). */
function notice(kind: "inf" | "bad", title: string, text: string): void {
  if (failed) return;
  byId("notice-box").className = `note ${kind}`;
  setText("notice-title", title);
  setText("notice-text", text);
  setShown("notice", true);
}
