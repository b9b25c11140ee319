/** /jobs/ID: where a job stands, live; once it is done its verdict, map and hopeless views. */
import { cancelJob, explain, findScene, readEvents, readJob, readObjects, readReport, readShards, retryJob } from "../api/client";
import { EventStream, type Line } from "../api/event_stream";
import type { Box, EventPage, JobDetail, JobEvent } from "../api/types";
import { estimate, Ratchet, type History } from "./estimate";
import { h } from "./element";
import { confirmed, failed, main, note, onKey, openPage, showLine } from "./frame";
import { clock } from "./format";
import { hopelessPanel } from "./hopeless";
import { DigitKeys } from "./digit_keys";
import { drawHead, readHistories } from "./job_head";
import { addHistory, apply, emptyState, setShards } from "./job_state";
import { emptyLive, takeLive } from "./live";
import { LivePanel } from "./live_panel";
import { LogDrawer } from "./log_drawer";
import { liveMapData, readMap } from "./map_data";
import { readPlan } from "./read_plan";
import { Redraw } from "./redraw";
import type { Report } from "./report_types";
import { planCaption } from "./scene_plan";
import { ShardGrid } from "./shard_grid";
import { grown, StageStrip } from "./stage_strip";
import { ViewMap } from "./view_map";

const LOG_EVENTS = 500; // of the past, read for the log
const REREAD_MS = 400;
const TICK_MS = 1000;

const id = decodeURIComponent(location.pathname.split("/").filter(Boolean)[1] ?? "");
await openPage([["1 … 14", "stage by its number"], ["L", "log"], ["M", "what the map shows"], ["← → ↑ ↓ + -", "cell, zoom (map focused: arrows)"], ["V", "stand at the selected cell"]]);
await start().catch((error: unknown) => failed(main, error, "This job cannot be shown", () => location.reload()));

async function start(): Promise<void> {
  let [job, past] = await Promise.all([readJob(id), readEvents(id, 0, 1000, "progress").catch(() => ({ events: [], next: 0 }) as EventPage)]);
  let readAtMs = Date.now();
  let histories: History[] = [];
  let report: Report | null = null;
  const state = emptyState();
  const ended = (): boolean => !["queued", "running"].includes(job.state);
  let map: ViewMap | null = null;
  const ratchet = new Ratchet();
  const grid = new ShardGrid(state, (who) => log.only(who));
  const live = emptyLive();
  for (const event of past.events) if (event.seq <= job.last_event) takeLive(live, event);
  const curves = new LivePanel(live, job.name);
  const log = new LogDrawer(state, job.name, job.stages.map((s) => s.name));
  const strip = new StageStrip((stage) => {
    grid.filter(stage);
    log.filter(stage);
  });
  const head = h("div");
  const says = h("div", { role: "status", class: "toast" });
  const left = h("div", { class: "col" });
  const two = h("div", { class: "two" }, left, h("div", { class: "col" }, ended() && !live.points.length ? null : curves.element, grid.element));
  const below = h("div");
  main.replaceChildren(head, says, strip.element, two, below, log.element);
  document.title = `${job.name} · farfield`;

  const draw = (): void => {
    const stages = ended() ? job.stages : grown(job.stages, readAtMs);
    const found = estimate(stages, histories);
    const heading = live.map && { hopeless: live.hopeless, views: live.map.views.reduce((n, v) => n + v, 0), smallestBudget: live.smallestBudget, unit: live.map.unit };
    drawHead(head, job, report, heading, { ...found, fraction: ratchet.at(id, found.fraction) }, { cancel: () => void cancel(), retry: () => void retry() });
    strip.show(stages);
  };

  async function cancel(): Promise<void> {
    const yes = await confirmed(`Cancel ${job.name}?`, "What is computed so far is kept, and a new job with the same scene and settings starts from there.", "Cancel the job", "Let it run");
    if (!yes) return;
    try {
      take(await cancelJob(id));
    } catch (error) {
      says.replaceChildren(note("bad", "fail", "Not cancelled", explain(error).text));
    }
  }

  async function retry(): Promise<void> {
    try {
      await retryJob(id);
      location.reload(); // its stream had ended: begin as with a new job
    } catch (error) {
      says.replaceChildren(note("bad", "fail", "Not started again", explain(error).text));
    }
  }

  function take(fresh: JobDetail): void {
    const wasOpen = !ended();
    job = fresh;
    readAtMs = Date.now();
    draw();
    if (wasOpen && ended()) void finish();
  }

  let rereading: ReturnType<typeof setTimeout> | undefined;
  const reread = (): void => {
    rereading ??= setTimeout(() => {
      rereading = undefined;
      readJob(id).then(take, () => undefined); // the stream says when the line is dead
    }, REREAD_MS);
  };

  /** Seconds, peaks and workers are not in events: read once more when all is over. */
  async function finish(): Promise<void> {
    await readAllShards();
    if (job.state !== "done") return;
    try {
      report = await readReport<Report>({ job: id });
      draw();
      const done = await readMap(id, report).then((data) => new ViewMap(data, id), () => null);
      if (done) left.replaceChildren((map = done).element);
      const hopeless = hopelessPanel(report, id, (cell) => done?.select(cell));
      if (hopeless) below.replaceChildren(hopeless);
    } catch (error) {
      says.replaceChildren(note("bad", "fail", "The result cannot be read", explain(error).text));
    }
  }

  let footprints: Box[] | null = null;
  /** The map of what the optimiser tells, until there is that of the placement. */
  const drawLive = async (): Promise<void> => {
    const done = (): boolean => job.state === "done";
    if (!live.map || done()) return;
    footprints ??= await readObjects(job.scene).then(({ objects }) => objects.map((o) => o.box), () => []);
    if (!map && !done()) left.replaceChildren((map = new ViewMap(liveMapData(live.map, footprints), null)).element);
    if (live.tiles) map?.setUnsolved(live.tiles);
  };
  const mapDraw = new Redraw(() => void drawLive());

  async function readAllShards(): Promise<void> {
    for (const stage of job.stages) if (stage.state !== "waiting") setShards(state, stage.name, (await readShards(id, stage.name)).shards);
    grid.draw();
  }

  draw();
  if (live.map) void drawLive();
  else void drawPlan(job, left);
  for (const key of ["m", "v", "+", "=", "-"]) onKey(key, () => map?.key(key));
  onKey("l", () => log.toggle());
  const digits = new DigitKeys();
  for (let k = 0; k <= 9; k++) onKey(String(k), (e) => strip.pick(digits.press(k, e.timeStamp, job.stages.length) - 1));
  await readAllShards();
  past = await readEvents(id, Math.max(0, job.last_event - LOG_EVENTS), LOG_EVENTS);
  addHistory(state, past.events.filter((e) => e.seq <= job.last_event));
  grid.draw();
  log.changed();
  if (ended()) await finish();
  else histories = await readHistories(id).catch(() => []);
  draw();

  let lost = false;
  let seenLost = false;
  const stream = new EventStream(id, job.last_event, {
    event: (event: JobEvent) => {
      if (takeLive(live, event)) {
        curves.changed();
        mapDraw.soon();
      }
      if (apply(state, event)) reread();
      else if (event.kind !== "progress") bump(job, event);
      grid.changed();
      log.changed();
    },
    line: (line: Line) => {
      lost = line.state === "lost";
      if (line.state === "live" && seenLost) reread();
      seenLost ||= lost;
      told(line, says, () => stream.retryNow());
    },
  });
  setInterval(() => {
    if (ended() || lost) return; // what is dated stands still
    draw();
    grid.changed();
  }, TICK_MS);
  addEventListener("pagehide", () => stream.close());
}

/** Until the cells are known: what the level is from above, and where the camera may be. */
async function drawPlan(job: JobDetail, where: HTMLElement): Promise<void> {
  if (job.state === "done") return;
  const scene = await findScene(job.scene).catch(() => null);
  const boxes = job.settings.view_space?.boxes ?? scene?.suggested?.view_space.boxes;
  if (!scene?.bounds || !boxes || where.childElementCount) return;
  const plan = await readPlan(scene, scene.bounds, boxes);
  if (where.childElementCount) return;
  where.append(h("section", { class: "panel", "aria-labelledby": "ph" }, h("header", null, h("h2", { id: "ph" }, "View space from above"), h("span", { class: "small q" }, "cells are coloured once their costs are known")),
    h("div", { class: "map" }, plan), h("p", { class: "small q2" }, planCaption(boxes))));
}

/** Counts of the running stage move with each shard, without asking again. */
function bump(job: JobDetail, event: JobEvent): void {
  const stage = job.stages.find((s) => s.name === event.data.stage);
  if (!stage || event.data.kind !== "run") return;
  if (event.data.state === "done") {
    stage.shards.done = Math.min(stage.shards.total, stage.shards.done + 1);
    stage.shards.running = Math.max(0, stage.shards.running - 1);
  } else if (event.data.state === "running") stage.shards.running++;
}

function told(line: Line, says: HTMLElement, retry: () => void): void {
  if (line.state === "live" || line.state === "ended") {
    showLine(line.state === "live" ? true : null);
    says.replaceChildren();
  } else if (line.state === "lost") {
    showLine(false, line.sinceMs);
    const wait = Math.max(1, Math.round((line.retryAtMs - Date.now()) / 1000));
    const text = `What you see is as of ${clock(line.sinceMs)}. Trying again in ${wait} s; nothing is lost, the stream resumes after event ${line.lastEvent.toLocaleString("en")}.`;
    says.replaceChildren(note("inf", "infeas", `Not live since ${clock(line.sinceMs)}`, text, h("button", { type: "button", onclick: retry }, "Try now")));
  } else {
    showLine(null);
    failed(says, line.error, "No longer live", () => location.reload());
  }
}

