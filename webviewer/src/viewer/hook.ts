/**
 * `window.farfield`: the viewer for scripts. Positions and directions are scene metres; counts and pictures are at the
 * placement's full resolution, whatever the size of the window. Described in webviewer/README.md.
 */
import { chunkOfCell, impostorsOfView, viewInChunk } from "../placementdb/placement";
import { sha256 } from "../placementdb/sha256";
import { findCell } from "../select/cells";
import { insideBoxes } from "../select/clamp";
import { findInterval } from "../select/intervals";
import { decodeWalk } from "../walk/walk";
import type { App, Switches } from "./app";

const LOOKUPS = 20_000;

export interface Stats {
  calls: number; // draw calls really made: geometry primitives, and one for all impostor layers
  triangles: number;
  cost: number; // of what was drawn, by the manifest's cost model, per_frame included
  budget: number;
  unit: string;
  geometryCost: number; // of the same view without impostors
  costBound: number; // that the placement states for this cell and interval
  objects: number; // drawn as geometry
  geometryObjects: number; // that geometry alone would draw
  impostors: number; // drawn
  impostorsWaiting: number; // of the view's impostors, still drawn as geometry
  coveredPixels: number; // share of the picture that shows an impostor
  cell: number;
  interval: number;
  problemView: number | null;
  hopeless: boolean;
  inside: boolean; // within the view space
  position: number[];
  direction: number[];
  overForStreaming: number;
  over: number; // frames over budget, of those the guarantee speaks of
  residentPages: number;
  missing: number; // objects drawn at another level of detail or as boxes: their geometry is not here
  boxes: number; // of them
  incomplete: number; // frames so far with any
  memory: { level: number; mostLevel: number; mostChunks: number; evictions: number; pages: number }; // bytes; video memory of the level, system memory of chunks, video memory held for impostors
  firstWholeMs: number; // when the first image without stand-ins was there, since the page was opened
  firstWholeBytes: number; // of the placement that had come by then
}

export interface Hook {
  ready: () => Promise<void>;
  setView: (position: number[], direction: number[]) => Promise<void>;
  setMode: (modes: Switches) => Promise<void>;
  stats: () => Promise<Stats>;
  capture: () => Promise<string>;
  difference: () => Promise<number>; // mean FLIP of the view against geometry, as the page shows it
  share: () => Promise<string>; // fragment of a link
  replay: (walk?: string) => Promise<string>; // CSV of one replay of the walk, or of the one that is there
  coverage: () => Promise<string>;
  pageDigests: (page: number) => Promise<string[]>;
  lookupUs: (views: number[][]) => Promise<number>; // microseconds that finding the impostors of a view takes; rows of position and direction
}

/** `started` resolves with the running viewer, or rejects with what went wrong. */
export function makeHook(started: Promise<App>): Hook {
  const settled = async (): Promise<App> => {
    const app = await started;
    await app.settle();
    return app;
  };
  return {
    ready: async () => void (await settled()),
    setView: async (position, direction) => {
      const app = await started;
      app.walker.look(position, direction);
      app.touch();
      await app.settle();
    },
    setMode: async (modes) => {
      (await started).setMode(modes);
      await settled();
    },
    stats: async () => read(await settled()),
    capture: async () => {
      const app = await settled();
      return app.atFullSize(() => {
        app.engine.draw(app.walker.position, app.walker.direction);
        return (app.engine.gl.canvas as HTMLCanvasElement).toDataURL("image/png");
      });
    },
    difference: async () => {
      const app = await settled();
      app.setMode({ difference: true });
      return app.difference.settled();
    },
    share: async () => (await started).shared(),
    replay: async (walk) => {
      const app = await settled();
      if (walk !== undefined) app.walks.take(decodeWalk(walk));
      await app.walks.replay();
      return app.walks.csv();
    },
    coverage: async () => {
      const app = await settled();
      return app.atFullSize(() => {
        app.engine.drawIds(app.walker.position, app.walker.direction);
        return (app.engine.gl.canvas as HTMLCanvasElement).toDataURL("image/png");
      });
    },
    lookupUs: async (views) => timeLookups(await started, views),
    pageDigests: async (page) => Promise.all((await settled()).engine.pages.read(page).map((level) => sha256(level))),
  };
}

/** Mean over the views, each looked up often enough for the clock; views whose chunk is not here count as far as they go. */
function timeLookups(app: App, views: readonly number[][]): number {
  const { placement } = app;
  const { manifest, index } = placement;
  const rows = views.map((row) => [row.slice(0, 3), row.slice(3)] as const);
  const rounds = Math.ceil(LOOKUPS / rows.length);
  let found = 0;
  const began = performance.now();
  for (let round = 0; round < rounds; round++) {
    for (const [position, direction] of rows) {
      const cell = findCell(index, manifest, position);
      const interval = findInterval(manifest.interval_edges, direction);
      const number = cell < 0 ? -1 : chunkOfCell(manifest, cell);
      const chunk = number < 0 ? undefined : placement.residentChunk(number);
      const view = chunk ? viewInChunk(chunk, cell, interval) : -1;
      if (view >= 0) found += impostorsOfView(chunk!, view).length;
    }
  }
  const ms = performance.now() - began;
  return found >= 0 ? (1000 * ms) / (rounds * rows.length) : NaN; // `found` is used: nothing may be left out
}

function read(app: App): Stats {
  return app.atFullSize(() => {
    const { engine, walker } = app;
    const { position, direction } = walker;
    const ids = engine.drawIds(position, direction);
    let covered = 0;
    for (let i = 0; i < ids.length; i += 4) if (ids[i] | ids[i + 1] | ids[i + 2]) covered++;
    engine.draw(position, direction);
    const { selection: s, situation, drawn } = engine;
    const { budget, view_space } = app.placement.manifest;
    return {
      calls: drawn.calls, triangles: drawn.triangles, cost: s.cost, budget: budget.amount, unit: budget.unit,
      geometryCost: s.geometryCost, costBound: situation.costBound, objects: s.nObjects, geometryObjects: s.geometryObjects,
      impostors: engine.modes.impostors ? situation.shown.length : 0,
      impostorsWaiting: situation.impostors - situation.shown.length, coveredPixels: (4 * covered) / ids.length,
      cell: situation.cell, interval: situation.interval, problemView: situation.problemView, hopeless: situation.hopeless,
      inside: insideBoxes(view_space, position), position: [...position], direction: [...direction],
      overForStreaming: app.counts.overForStreaming, over: app.counts.over, residentPages: engine.pages.residentPages,
      missing: engine.standIns.missing, boxes: engine.standIns.boxes, incomplete: app.counts.incomplete, firstWholeMs: app.firstWholeMs,
      firstWholeBytes: app.firstWholeBytes,
      memory: {
        level: engine.level.pages?.bytes ?? 0, mostLevel: engine.level.pages?.mostBytes ?? 0, mostChunks: app.streamer.mostChunkBytes,
        evictions: engine.level.pages?.evictions ?? 0, pages: engine.pages.slots * engine.pages.bytesPerPage,
      },
    };
  });
}
