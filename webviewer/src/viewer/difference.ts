/**
 * The difference picture: FLIP of what is drawn against geometry, over the picture, whenever the camera rests. While it moves the picture
 * itself shows. The pictures are read back once a rest and compared in a worker, never in a frame.
 */
import type { FlipAnswered, FlipAsked } from "../error/flip_worker";
import { byId, setShown, setText } from "../ui/dom";
import type { Engine } from "./engine";

const STEPS = 7; // --q0 to --q6

export class Difference {
  on = false;
  mean = NaN; // of the view that is shown
  private readonly canvas = byId<HTMLCanvasElement>("difference");
  private worker: Worker | null = null;
  private asked = 0;
  private busy = false;
  private key = "";
  private waiting: ((mean: number) => void)[] = [];

  constructor(private readonly engine: Engine) {}

  set(on: boolean): void {
    this.on = on;
    this.clear();
    setShown("difference-said", on);
  }

  /** What is shown is no longer the view's. */
  clear(): void {
    if (this.key === "" && this.canvas.hidden) return;
    this.key = "";
    this.mean = NaN;
    this.canvas.hidden = true;
    if (this.on) setText("difference-mean", "compared when the camera rests");
  }

  /** The camera rests at the view that `key` names: compares unless that is done or under way. True: it has drawn into the canvas. */
  rest(key: string, position: [number, number, number], direction: [number, number, number]): boolean {
    if (!this.on || this.busy || key === this.key) return false;
    this.key = key;
    this.busy = true;
    setText("difference-mean", "comparing");
    const { engine } = this;
    const { width, height } = engine.gl.canvas;
    const read = (impostors: boolean): Uint8Array => engine.drawPlain(position, direction, impostors);
    const [truth, shown] = [read(false), read(true)];
    const scale = Array.from({ length: STEPS }, (_, k) => rgbOf(`--q${k}`));
    const question: FlipAsked = { number: ++this.asked, truth, shown, width, height, scale };
    this.start().postMessage(question, [truth.buffer, shown.buffer]);
    return true;
  }

  /** The mean of the view that rests, as soon as it is known. */
  settled(): Promise<number> {
    return Number.isFinite(this.mean) ? Promise.resolve(this.mean) : new Promise((resolve) => this.waiting.push(resolve));
  }

  private start(): Worker {
    if (this.worker) return this.worker;
    this.worker = new Worker(new URL("../error/flip_worker.ts", import.meta.url), { type: "module" });
    this.worker.onmessage = (e: MessageEvent<FlipAnswered>) => this.answered(e.data);
    this.worker.onerror = () => {
      this.busy = false;
      setText("difference-mean", "cannot be compared: the page's worker has stopped. Load the page again.");
    };
    return this.worker;
  }

  private answered({ number, mean, worst, differing, pixels }: FlipAnswered): void {
    this.busy = false;
    const { width, height } = this.engine.gl.canvas;
    // The camera has moved on, or the window has another size.
    if (number !== this.asked || !this.on || this.key === "" || pixels.length !== 4 * width * height) {
      this.key = "";
      return;
    }
    this.canvas.width = width;
    this.canvas.height = height;
    this.canvas.getContext("2d")!.putImageData(new ImageData(pixels, width, height), 0, 0);
    this.canvas.hidden = false;
    this.mean = mean;
    setText("difference-mean", `mean ${mean.toFixed(4)}, worst ${worst.toFixed(2)}, ${(100 * differing).toFixed(1)} % of the pixels differ`);
    for (const resolve of this.waiting.splice(0)) resolve(mean);
  }
}

/** A colour token "#rrggbb" as numbers. */
function rgbOf(token: string): number[] {
  const value = getComputedStyle(document.documentElement).getPropertyValue(token).trim();
  return [1, 3, 5].map((k) => Number.parseInt(value.slice(k, k + 2), 16) || 0);
}
