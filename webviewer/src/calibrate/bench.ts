/**
 * Draws controlled frames as the viewer draws them, and times them.
 *
 * Time of a frame: that of the GPU (EXT_disjoint_timer_query_webgl2) or that of the processor's submission, whichever is
 * longer. Without the extension as many equal frames as take `SPAN_MS` go behind one fence, and the time until it is passed
 * is shared out: errs upwards by the wait for the fence, less than a millisecond by their number. The median of `REPEATS`.
 * Each frame is drawn once before, untimed: uploads and compiled shaders are no part of it.
 */
import { makeView, setViewProjection, PICTURE } from "../draw/view";
import { gpuTimer, makeContext } from "../gl/context";
import { PictureTarget } from "../gl/picture_target";
import { Layers } from "./layers";
import { Objects } from "./objects";
import { alone, COLUMNS, FIRST, frameAt, FRAMES, MOST, NOTHING, TARGET_MS, type Load, type Sample } from "./plan";

const REPEATS = 3;
const SPAN_MS = 12;
const MOST_EQUAL = 16;
const GIVE_UP_MS = 10_000;

export class DriverReset extends Error {
  readonly advice = "Measure again, with other programs that draw closed.";
  constructor() {
    super("The graphics driver has reset, or does not answer.");
  }
}

export class Bench {
  readonly renderer: string;
  readonly timed: "gpu timer" | "fences";
  private readonly gl: WebGL2RenderingContext;
  private readonly timer: ReturnType<typeof gpuTimer>;
  private readonly target: PictureTarget;
  private readonly objects: Objects;
  private readonly layers: Layers;
  private readonly view = makeView();
  private readonly stats = { calls: 0, triangles: 0 };

  /** `canvas` has the size of the pictures to come. */
  constructor(private readonly canvas: HTMLCanvasElement) {
    const gl = (this.gl = makeContext(canvas));
    this.timer = gpuTimer(gl);
    this.timed = this.timer ? "gpu timer" : "fences";
    const named = gl.getExtension("WEBGL_debug_renderer_info");
    this.renderer = String(gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
    this.target = new PictureTarget(gl);
    this.objects = new Objects(canvas, gl);
    this.layers = new Layers(gl);
    this.view.tanY = Math.tan(Math.PI / 8);
    this.view.tanX = (this.view.tanY * canvas.width) / canvas.height;
    this.view.mode = PICTURE;
    setViewProjection(this.view);
  }

  /** Yields frames as they are measured, until all are or `signal` stops them. `prepared` hears of the search for a scale. */
  async *measure(signal: AbortSignal, prepared: (share: number) => void): AsyncGenerator<Sample> {
    const most = await this.scale(signal, prepared);
    for (let k = 0; k < FRAMES && !signal.aborted; k++) yield await this.sample(frameAt(k, most));
  }

  async sample(load: Load): Promise<Sample> {
    const counted = await this.prepare(load);
    const first = await this.time(1);
    const equal = this.timer ? 1 : Math.max(1, Math.min(MOST_EQUAL, Math.ceil(SPAN_MS / Math.max(0.1, first))));
    const times: number[] = [];
    for (let k = 0; k < REPEATS; k++) times.push(await this.time(equal));
    times.sort((a, b) => a - b);
    return { ...counted, ms: Number(Math.max(times[REPEATS >> 1], 1e-3).toFixed(4)) };
  }

  dispose(): void {
    this.objects.dispose();
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** The heaviest value of each column: where it alone takes TARGET_MS more than an empty frame. */
  private async scale(signal: AbortSignal, prepared: (share: number) => void): Promise<Load> {
    const most = { ...FIRST };
    await this.prepare(NOTHING);
    const empty = Math.min(await this.time(1), await this.time(1));
    for (const [k, column] of COLUMNS.entries()) {
      for (;;) {
        prepared(k / COLUMNS.length);
        if (signal.aborted || most[column] >= MOST[column]) break;
        await this.prepare(alone(column, most[column]));
        await this.time(1);
        if ((await this.time(1)) - empty >= TARGET_MS) break;
        most[column] *= 2;
      }
    }
    return most;
  }

  /** Lays a frame out and draws it once; returns what it really draws. */
  private async prepare(load: Load): Promise<Load> {
    const { width, height } = this.canvas;
    const layers = this.layers.prepare(load, this.view, width, height);
    const objects = this.objects.prepare(load, this.view, width, height);
    this.draw();
    await this.passed();
    return { ...objects, ...layers };
  }

  /** Milliseconds a frame, of so many equal ones. */
  private async time(equal: number): Promise<number> {
    const { gl, timer } = this;
    for (let attempt = 0; ; attempt++) {
      const query = timer && gl.createQuery();
      const began = performance.now();
      if (timer && query) gl.beginQuery(timer.TIME_ELAPSED_EXT, query);
      for (let k = 0; k < equal; k++) this.draw();
      if (timer && query) gl.endQuery(timer.TIME_ELAPSED_EXT);
      gl.flush();
      const submitted = performance.now() - began;
      await this.passed();
      const all = performance.now() - began;
      if (!timer || !query) return all / equal;
      while (!gl.getQueryParameter(query, gl.QUERY_RESULT_AVAILABLE)) {
        if (performance.now() - began > GIVE_UP_MS) throw new DriverReset();
        await turn();
      }
      const gpu = (gl.getQueryParameter(query, gl.QUERY_RESULT) as number) / 1e6;
      gl.deleteQuery(query);
      if (!gl.getParameter(timer.GPU_DISJOINT_EXT)) return Math.max(submitted, gpu) / equal;
      if (attempt === REPEATS) return all / equal; // the clock keeps changing: wall time errs upwards
    }
  }

  private draw(): void {
    const { gl, target } = this;
    const { width, height } = this.canvas;
    target.bind(width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.depthMask(true);
    gl.colorMask(true, true, true, true);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.1, 0.12, 0.12, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.layers.draw(this.view, this.stats);
    const { renderer } = this.objects;
    renderer.resetState();
    target.bind(width, height);
    renderer.setViewport(0, 0, width, height);
    this.objects.draw();
    target.show();
  }

  /** Resolves once the GPU has done all it was told. */
  private async passed(): Promise<void> {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) throw new DriverReset();
    gl.flush();
    const began = performance.now();
    for (;;) {
      const state = gl.clientWaitSync(fence, 0, 0);
      if (state === gl.ALREADY_SIGNALED || state === gl.CONDITION_SATISFIED) break;
      if (state === gl.WAIT_FAILED || gl.isContextLost() || performance.now() - began > GIVE_UP_MS) throw new DriverReset();
      await turn();
    }
    gl.deleteSync(fence);
  }
}

const channel = new MessageChannel();
const waiting: (() => void)[] = [];
channel.port1.onmessage = () => waiting.shift()?.();

/** A turn of the event loop, without the four milliseconds that a timer takes. */
function turn(): Promise<void> {
  return new Promise((resolve) => {
    waiting.push(resolve);
    channel.port2.postMessage(0);
  });
}
