/** How long frames take: the GPU's own timer where there is one, else the interval between frames. */
import { gpuTimer } from "../gl/context";

export const FRAMES_KEPT = 140;

export class FrameClock {
  readonly ms = new Float64Array(FRAMES_KEPT);
  readonly cost = new Float64Array(FRAMES_KEPT);
  readonly geometryCost = new Float64Array(FRAMES_KEPT);
  readonly late = new Uint8Array(FRAMES_KEPT);
  /** 1 where `ms` is what the frame took, 0 while only the CPU's part of it is known. */
  private readonly known = new Uint8Array(FRAMES_KEPT);
  frames = 0;
  /** Told the time of a frame, a second time where the GPU's own comes later. */
  measured: ((frame: number, ms: number) => void) | null = null;
  readonly source: "gpu timer" | "frame interval";
  private readonly gl: WebGL2RenderingContext;
  private readonly timer: ReturnType<typeof gpuTimer>;
  private readonly waiting: { query: WebGLQuery; frame: number; cpuMs: number }[] = [];
  private readonly free: WebGLQuery[] = [];
  private active: WebGLQuery | null = null;
  private beganAt = 0;
  private lastBegan = 0;

  constructor(gl: WebGL2RenderingContext) {
    this.gl = gl;
    this.timer = gpuTimer(gl);
    this.source = this.timer ? "gpu timer" : "frame interval";
  }

  begin(): void {
    this.lastBegan = this.beganAt;
    this.beganAt = performance.now();
    if (!this.timer || this.waiting.length >= 8) return;
    this.active = this.free.pop() ?? this.gl.createQuery()!;
    this.gl.beginQuery(this.timer.TIME_ELAPSED_EXT, this.active);
  }

  /** `cost` and `geometryCost` as the model predicts them, in the budget's unit. */
  end(cost: number, geometryCost: number, late: boolean): void {
    const cpuMs = performance.now() - this.beganAt;
    const at = this.frames % FRAMES_KEPT;
    this.cost[at] = cost;
    this.geometryCost[at] = geometryCost;
    this.late[at] = late ? 1 : 0;
    const interval = this.beganAt - this.lastBegan;
    this.ms[at] = this.timer || interval > 250 ? cpuMs : Math.max(cpuMs, interval);
    this.known[at] = this.timer ? 0 : 1;
    this.measured?.(this.frames, this.ms[at]);
    if (this.active) {
      this.gl.endQuery(this.timer!.TIME_ELAPSED_EXT);
      this.waiting.push({ query: this.active, frame: this.frames, cpuMs });
      this.active = null;
    }
    this.frames++;
    this.collect();
  }

  /** Median of the frames of about the last half second (at least 5) whose time is known; null before there is one. */
  median(): number | null {
    const n = Math.min(this.frames, FRAMES_KEPT, 30);
    const last: number[] = [];
    let sum = 0;
    for (let k = 1; k <= n && (last.length < 5 || sum < 500); k++) {
      const at = (this.frames - k) % FRAMES_KEPT;
      if (!this.known[at]) continue;
      const ms = this.ms[at];
      last.push(ms);
      sum += ms;
    }
    last.sort((a, b) => a - b);
    return last.length ? last[last.length >> 1] : null;
  }

  /** Takes the times that the GPU has ready by now. */
  collect(): void {
    const { gl, timer, waiting } = this;
    while (timer && waiting.length && gl.getQueryParameter(waiting[0].query, gl.QUERY_RESULT_AVAILABLE)) {
      const { query, frame, cpuMs } = waiting.shift()!;
      const disjoint = gl.getParameter(timer.GPU_DISJOINT_EXT);
      const gpuMs = (gl.getQueryParameter(query, gl.QUERY_RESULT) as number) / 1e6;
      if (!disjoint && this.frames - frame <= FRAMES_KEPT) {
        this.ms[frame % FRAMES_KEPT] = Math.max(cpuMs, gpuMs);
        this.known[frame % FRAMES_KEPT] = 1;
        this.measured?.(frame, this.ms[frame % FRAMES_KEPT]);
      }
      this.free.push(query);
    }
  }
}
