/**
 * Recording and replaying a walk, and its panel. A replay puts the camera where the walk was at fixed steps, one a frame drawn,
 * however long a frame takes: the same link shows the same frames everywhere.
 */
import type { Manifest, Vec3 } from "../placementdb/manifest";
import { download } from "../ui/csv";
import { byId, setShown, setText } from "../ui/dom";
import { count } from "../ui/format";
import { BROKEN, HOPELESS, STREAMING, UNPROMISED, WalkLog, walkCsv, walkPlot, type FrameFacts } from "../walk/log";
import { Recorder, STEP_MS, type Walk } from "../walk/walk";
import type { Walker } from "./camera";
import type { FrameClock } from "./frame_clock";

export class Walks {
  walk: Walk | null = null;
  log: WalkLog | null = null; // of the last replay, or of the one that runs
  recording = false;
  private before: WalkLog | null = null; // the replay before, of the same walk
  private frame = -1; // the next frame of the replay; -1: none runs
  private firstFrame = 0; // of the clock
  private nowMs = 0;
  private ended: (() => void) | null = null;
  private readonly recorder = new Recorder();
  private readonly position: Vec3 = [0, 0, 0];
  private readonly direction: Vec3 = [0, 0, -1];

  constructor(
    private readonly walker: Walker,
    private readonly clock: FrameClock,
    private readonly manifest: Manifest,
    private readonly name: string,
  ) {
    clock.measured = (frame, ms) => {
      const row = frame - this.firstFrame;
      if (this.log && row >= 0 && row < this.log.count) this.log.ms[row] = ms;
    };
    byId("b-record").addEventListener("click", () => this.record());
    byId("b-replay").addEventListener("click", () => void this.replay());
    byId("b-csv").addEventListener("click", () => this.save("csv"));
    byId("b-plot").addEventListener("click", () => this.save("svg"));
    this.write();
  }

  get replaying(): boolean {
    return this.frame >= 0;
  }

  /** A walk from a link; null: none. */
  take(walk: Walk | null): void {
    this.stop();
    this.walk = walk;
    this.log = this.before = null;
    this.say("");
    this.write();
  }

  /** Before a frame is drawn: samples the camera, or puts it where the walk is. */
  advance(nowMs: number): void {
    this.nowMs = nowMs;
    if (this.recording) {
      this.recorder.add(nowMs, this.walker.position, this.walker.yaw, this.walker.pitch);
      if (this.recorder.full) this.record();
    }
    if (this.frame < 0) return;
    const { walker, position } = this;
    this.walk!.at(this.frame * STEP_MS, position, this.direction);
    const seconds = this.frame ? STEP_MS / 1000 : Infinity;
    const [x, y, z] = walker.position;
    walker.look(position, this.direction);
    // What is fetched ahead follows the motion, as it does on foot.
    walker.velocity[0] = (position[0] - x) / seconds;
    walker.velocity[1] = (position[1] - y) / seconds;
    walker.velocity[2] = (position[2] - z) / seconds;
  }

  /** After a frame was drawn and its time begun to be measured. */
  drawn(facts: FrameFacts): void {
    if (this.frame < 0) return;
    this.log!.add(facts);
    this.frame++;
    if (this.frame >= this.log!.frames) this.stop();
  }

  /** Starts recording, or ends it and keeps the walk. */
  record(): void {
    this.stop();
    if (!this.recording) {
      this.recorder.start();
      this.recording = true;
      this.say("");
    } else {
      this.recording = false;
      this.recorder.add(this.nowMs + 25, this.walker.position, this.walker.yaw, this.walker.pitch);
      try {
        const walk = this.recorder.finish();
        if (walk) [this.walk, this.log, this.before] = [walk, null, null];
        this.say("");
      } catch (error) {
        this.say(error instanceof Error ? error.message : String(error));
      }
    }
    this.write();
  }

  /** Starts the replay, or ends it. Resolves when it has ended. */
  replay(): Promise<void> {
    if (this.replaying || !this.walk) {
      this.stop();
      return Promise.resolve();
    }
    if (this.recording) this.record();
    if (this.log && this.log.count === this.log.frames) this.before = this.log;
    this.log = new WalkLog(this.walk.frames);
    this.firstFrame = this.clock.frames;
    this.frame = 0;
    this.write();
    return new Promise((resolve) => (this.ended = resolve));
  }

  stop(): void {
    if (this.frame < 0) return;
    this.frame = -1;
    this.walker.velocity.fill(0);
    this.ended?.();
    this.ended = null;
    this.write();
  }

  say(words: string): void {
    setText("walk-said", words);
    setShown("walk-said", words !== "");
  }

  csv(): string {
    return this.log ? walkCsv(this.log, STEP_MS) : "";
  }

  /** The panel: called when something has changed, and ten times a second while a walk is on. */
  write(): void {
    const { walk, log, recording, replaying } = this;
    const length = recording ? this.recorder.ms : (walk?.lengthMs ?? 0);
    setText("record-word", recording ? "Stop" : "Record");
    setText("replay-word", replaying ? "Stop" : "Replay");
    byId("b-record").setAttribute("aria-pressed", String(recording));
    byId("b-replay").setAttribute("aria-pressed", String(replaying));
    byId<HTMLButtonElement>("b-replay").disabled = !walk;
    for (const id of ["b-csv", "b-plot"]) byId<HTMLButtonElement>(id).disabled = !log || replaying || !log.count;
    const done = log ? log.count : 0;
    const share = log ? (100 * done) / log.frames : 0;
    byId<HTMLElement>("walk-bar-fill").style.width = `${share}%`;
    byId("walk-bar").setAttribute("aria-valuenow", String(Math.round(share)));
    setText("walk-frames", recording ? "recording" : !walk ? "no walk yet" : log ? `${count(done)} of ${count(log.frames)} frames` : `${count(walk.frames)} frames`);
    setText("walk-time", replaying ? `${clockTime(done * STEP_MS)} of ${clockTime(length)}` : length ? clockTime(length) : "");
    setShown("walk-result", done > 0);
    if (done) setText("walk-result", `${summary(log!)}${this.before && !replaying ? ` Before: ${summary(this.before)}` : ""}`);
  }

  private save(kind: "csv" | "svg"): void {
    const { log } = this;
    if (!log) return;
    const title = `${this.name}: ${summary(log)}`;
    const text = kind === "csv" ? this.csv() : walkPlot(log, STEP_MS, title, this.manifest.budget);
    download(`walk-${this.name.replace(/[^\w-]+/g, "-")}.${kind}`, text, kind === "csv" ? "text/csv" : "image/svg+xml");
  }
}

/** "p99 12.3 ms, worst 15.0; 4 over budget: 3 streaming, 1 hopeless." */
function summary(log: WalkLog): string {
  const causes = [
    [STREAMING, "not yet resident"], [HOPELESS, "hopeless"], [UNPROMISED, "not promised"], [BROKEN, "unexplained"],
  ] as const;
  const over = causes.filter(([reason]) => log.over(reason)).map(([reason, words]) => `${count(log.over(reason))} ${words}`);
  const told = over.length ? `${count(log.overBudget)} over budget: ${over.join(", ")}` : "none over budget";
  return `p99 ${log.percentileMs(0.99).toFixed(1)} ms, worst ${log.percentileMs(1).toFixed(1)}; ${told}.`;
}

function clockTime(ms: number): string {
  const seconds = Math.floor(ms / 1000);
  return `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
}
