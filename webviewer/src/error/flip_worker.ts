/** FLIP off the page's thread: two pictures in, the error as a picture and its mean out. */
import { flip } from "./flip";

export interface FlipAsked {
  number: number;
  truth: Uint8Array; // RGBA, bottom row first, as WebGL reads
  shown: Uint8Array;
  width: number;
  height: number;
  /** Colours of errors 0 to 1, evenly spaced, RGB 0 to 255. */
  scale: number[][];
}

export interface FlipAnswered {
  number: number;
  mean: number;
  worst: number;
  differing: number; // share of pixels with an error above 0
  pixels: Uint8ClampedArray<ArrayBuffer>; // RGBA, top row first
}

const FAINT = 0.35; // how much of the picture shines through where nothing differs

export function answer({ number, truth, shown, width, height, scale }: FlipAsked): FlipAnswered {
  const { mean, error } = flip(truth, shown, width, height);
  const pixels = new Uint8ClampedArray(4 * width * height);
  let worst = 0;
  let differing = 0;
  const [ground] = scale;
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const from = (height - 1 - y) * width + x;
      const to = 4 * (y * width + x);
      const e = error[from];
      worst = Math.max(worst, e);
      if (e > 0) differing++;
      const at = e * (scale.length - 1);
      const k = Math.min(scale.length - 2, Math.floor(at));
      const grey = 0.3 * truth[4 * from] + 0.59 * truth[4 * from + 1] + 0.11 * truth[4 * from + 2];
      const faint = FAINT * Math.max(0, 1 - 4 * e);
      for (let c = 0; c < 3; c++) {
        const color = scale[k][c] + (at - k) * (scale[k + 1][c] - scale[k][c]);
        pixels[to + c] = color * (1 - faint) + faint * (0.5 * ground[c] + 0.5 * grey);
      }
      pixels[to + 3] = 255;
    }
  }
  return { number, mean, worst, differing: differing / (width * height), pixels };
}

// In a worker `self` is its scope; where a test imports this file there is none.
if (typeof self !== "undefined" && typeof document === "undefined") {
  self.onmessage = (e: MessageEvent<FlipAsked>) => {
    const found = answer(e.data);
    (self as unknown as { postMessage: (m: unknown, t: Transferable[]) => void }).postMessage(found, [found.pixels.buffer]);
  };
}
