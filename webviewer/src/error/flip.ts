/**
 * FLIP for pictures of 8 bits a channel: how different two pictures look to somebody who flips between them.
 *
 * Problem  Per pixel a number in [0,1] and its mean, from two sRGB pictures and the pixels per degree of sight.
 * Method   Colour: both pictures filtered by the eye's contrast sensitivity (two Gaussians at most a channel, each separable) in
 *          a linear opponent space, compared as Hunt-adjusted L*a*b* by HyAB, and mapped so that small differences keep room.
 *          Features: first and second derivatives of Gaussians of the lightness find edges and points; what differs amplifies the
 *          colour difference as an exponent. Borders repeat. Taps below 1e-9 of a kernel's sum are left out.
 * After    Andersson, Nilsson, Akenine-Moeller, Oskarsson, Astroem, Fairchild. FLIP: A Difference Evaluator for Alternating
 *          Images. Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020.
 */

/** A 3840 px wide screen of 0.7 m seen from 0.7 m: what FLIP values are usually stated for. */
export const PIXELS_PER_DEGREE = (3840 * Math.PI) / 180;

const TO_XYZ = [
  [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
  [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
  [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
];
const WHITE = TO_XYZ.map((row) => row[0] + row[1] + row[2]);
const TO_RGB = inverse(TO_XYZ);
// Contrast sensitivity of each opponent channel as a sum of Gaussians: (amplitude, width) each.
const SENSITIVITY = [[[1, 0.0047]], [[1, 0.0053]], [[34.1, 0.04], [13.5, 0.025]]];
const FEATURE_DEGREES = 0.082;
const COLOR_POWER = 0.7;
const [KNEE, AT_KNEE] = [0.4, 0.95];
const FEATURE_POWER = 0.5;
const DECODED = Float64Array.from({ length: 256 }, (_, i) => (i <= 10 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4));
const LARGEST = hyab(huntLab(0, 1, 0), huntLab(0, 0, 1)) ** COLOR_POWER;

export interface Flip {
  mean: number;
  /** (height, width), 0 to 1, rows as the pictures'. */
  error: Float32Array;
}

/** `truth` and `shown`: RGBA, width x height, sRGB encoded; alpha is not looked at. */
export function flip(truth: Uint8Array, shown: Uint8Array, width: number, height: number, pixelsPerDegree = PIXELS_PER_DEGREE): Flip {
  const n = width * height;
  if (truth.length !== 4 * n || shown.length !== 4 * n) throw new RangeError(`flip wants two pictures of ${width} x ${height} pixels`);
  const [a, b] = [opponent(truth, n), opponent(shown, n)];
  const error = featureDifference(a[0], b[0], width, height, pixelsPerDegree);
  const [p, q] = [a, b].map((channels) => channels.map((channel, c) => filtered(channel, SENSITIVITY[c], width, height, pixelsPerDegree)));
  let sum = 0;
  for (let i = 0; i < n; i++) {
    const color = colorDifference(seen(p, i), seen(q, i));
    error[i] = color > 0 ? color ** (1 - error[i]) : 0;
    sum += error[i];
  }
  return { mean: n ? sum / n : 0, error };
}

/** Lightness, red-green and blue-yellow, all linear in light. */
function opponent(rgba: Uint8Array, n: number): Float32Array[] {
  const out = [new Float32Array(n), new Float32Array(n), new Float32Array(n)];
  for (let i = 0; i < n; i++) {
    const [r, g, b] = [DECODED[rgba[4 * i]], DECODED[rgba[4 * i + 1]], DECODED[rgba[4 * i + 2]]];
    const [x, y, z] = share(r, g, b);
    out[0][i] = 116 * y - 16;
    out[1][i] = 500 * (x - y);
    out[2][i] = 200 * (y - z);
  }
  return out;
}

/** X, Y and Z as shares of the white's. */
function share(r: number, g: number, b: number): [number, number, number] {
  const of = (row: number[], white: number): number => (row[0] * r + row[1] * g + row[2] * b) / white;
  return [of(TO_XYZ[0], WHITE[0]), of(TO_XYZ[1], WHITE[1]), of(TO_XYZ[2], WHITE[2])];
}

/** What the eye makes of pixel i of the filtered opponent channels. */
function seen(channels: Float32Array[], i: number): [number, number, number] {
  const y = (channels[0][i] + 16) / 116;
  const xyz = [(y + channels[1][i] / 500) * WHITE[0], y * WHITE[1], (y - channels[2][i] / 200) * WHITE[2]];
  const light = (row: number[]): number => Math.min(1, Math.max(0, row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]));
  return huntLab(light(TO_RGB[0]), light(TO_RGB[1]), light(TO_RGB[2]));
}

function huntLab(r: number, g: number, b: number): [number, number, number] {
  const f = (t: number): number => (t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29);
  const xyz = share(r, g, b);
  const [x, y, z] = [f(xyz[0]), f(xyz[1]), f(xyz[2])];
  const l = 116 * y - 16;
  return [l, 0.01 * l * 500 * (x - y), 0.01 * l * 200 * (y - z)];
}

function hyab(p: readonly number[], q: readonly number[]): number {
  return Math.abs(p[0] - q[0]) + Math.hypot(p[1] - q[1], p[2] - q[2]);
}

function colorDifference(p: readonly number[], q: readonly number[]): number {
  const d = hyab(p, q) ** COLOR_POWER;
  const knee = KNEE * LARGEST;
  return d < knee ? (AT_KNEE * d) / knee : AT_KNEE + ((d - knee) / (LARGEST - knee)) * (1 - AT_KNEE);
}

function filtered(channel: Float32Array, gaussians: number[][], width: number, height: number, perDegree: number): Float32Array {
  const widest = Math.max(...SENSITIVITY.flat().map(([, b]) => b));
  const radius = Math.ceil(3 * Math.sqrt(widest / (2 * Math.PI ** 2)) * perDegree);
  const parts = gaussians.map(([amplitude, b]) => {
    const taps = kernel(radius, (k) => Math.exp((-(Math.PI ** 2) * (k / perDegree) ** 2) / b));
    const total = taps.reduce((s, w) => s + w, 0);
    return { taps: taps.map((w) => w / total), weight: amplitude * Math.sqrt(Math.PI / b) * total * total };
  });
  const all = parts.reduce((s, part) => s + part.weight, 0);
  const out = new Float32Array(width * height);
  for (const { taps, weight } of parts) {
    const once = down(across(channel, taps, width, height), taps, width, height);
    for (let i = 0; i < out.length; i++) out[i] += (weight / all) * once[i];
  }
  return out;
}

/** How different edges and points are: the larger of both, 0 to 1. */
function featureDifference(a: Float32Array, b: Float32Array, width: number, height: number, perDegree: number): Float32Array {
  const deviation = 0.5 * FEATURE_DEGREES * perDegree;
  const radius = Math.ceil(3 * deviation);
  const bell = (k: number): number => Math.exp(-(k * k) / (2 * deviation * deviation));
  const total = kernel(radius, bell).reduce((s, w) => s + w, 0);
  const smooth = kernel(radius, (k) => bell(k) / total);
  const edge = balanced(kernel(radius, (k) => -k * bell(k)));
  const point = balanced(kernel(radius, (k) => ((k * k) / (deviation * deviation) - 1) * bell(k)));
  const strengths = [a, b].map((lightness) => {
    const y = lightness.map((v) => (v + 16) / 116);
    const flat = across(y, smooth, width, height);
    const both = (taps: number[]): Float32Array => {
      const horizontal = down(across(y, taps, width, height), smooth, width, height);
      const vertical = down(flat, taps, width, height);
      return horizontal.map((h, i) => Math.hypot(h, vertical[i]));
    };
    return [both(edge), both(point)];
  });
  const [p, q] = strengths;
  return p[0].map((_, i) => (Math.max(Math.abs(p[0][i] - q[0][i]), Math.abs(p[1][i] - q[1][i])) / Math.SQRT2) ** FEATURE_POWER);
}

function kernel(radius: number, value: (k: number) => number): number[] {
  return Array.from({ length: 2 * radius + 1 }, (_, k) => value(k - radius));
}

/** Scaled so that what is positive sums to 1 and what is negative to -1. */
function balanced(taps: number[]): number[] {
  const up = taps.reduce((s, w) => s + Math.max(0, w), 0);
  const low = -taps.reduce((s, w) => s + Math.min(0, w), 0);
  return taps.map((w) => (w > 0 ? w / up : w / low));
}

function across(from: Float32Array, taps: number[], width: number, height: number): Float32Array {
  const radius = taps.length >> 1;
  const out = new Float32Array(width * height);
  const padded = new Float32Array(width + 2 * radius);
  for (let y = 0; y < height; y++) {
    const row = out.subarray(y * width, (y + 1) * width);
    padded.set(from.subarray(y * width, (y + 1) * width), radius);
    padded.fill(from[y * width], 0, radius);
    padded.fill(from[(y + 1) * width - 1], radius + width);
    for (let k = 0; k < taps.length; k++) addScaled(row, padded, k, taps[k]);
  }
  return out;
}

function down(from: Float32Array, taps: number[], width: number, height: number): Float32Array {
  const radius = taps.length >> 1;
  const out = new Float32Array(width * height);
  for (let y = 0; y < height; y++) {
    const row = out.subarray(y * width, (y + 1) * width);
    for (let k = 0; k < taps.length; k++) {
      addScaled(row, from, Math.min(height - 1, Math.max(0, y + k - radius)) * width, taps[k]);
    }
  }
  return out;
}

function addScaled(row: Float32Array, from: Float32Array, start: number, weight: number): void {
  if (Math.abs(weight) < 1e-9) return;
  for (let x = 0; x < row.length; x++) row[x] += weight * from[start + x];
}

function inverse(m: number[][]): number[][] {
  const minor = (i: number, j: number): number => {
    const [r0, r1] = [0, 1, 2].filter((r) => r !== i);
    const [c0, c1] = [0, 1, 2].filter((c) => c !== j);
    return (m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0]) * ((i + j) % 2 ? -1 : 1);
  };
  const determinant = m[0][0] * minor(0, 0) + m[0][1] * minor(0, 1) + m[0][2] * minor(0, 2);
  return [0, 1, 2].map((i) => [0, 1, 2].map((j) => minor(j, i) / determinant));
}
