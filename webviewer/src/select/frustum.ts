/**
 * The view pyramid, and boxes against it by the full separating-axis test, in float64.
 *
 * Problem  An object is drawn iff its box meets the pyramid with apex at the eye (no near or far plane).
 * Method   A cone with apex 0 and a box are separated, if at all, by a facet normal of either or a cross product of
 *          edges, with the whole cone on one side: those normals do not depend on the box (error-metric.md section 10).
 *          So: four facets, the world axes the cone lies on one side of, and e x (corner ray) likewise; then a box is
 *          outside iff some normal has  N.q + |N|.g < 0  (q centre relative to the eye, g half sizes).
 * Errs     towards drawing, by 1e-12 of the distance.
 */
import type { Vec3 } from "../placementdb/manifest";

export interface CameraFrame {
  eye: Vec3;
  forward: Vec3;
  right: Vec3;
  up: Vec3;
}

export interface Frustum {
  eye: Vec3;
  forward: Vec3;
  right: Vec3;
  up: Vec3;
  tanX: number;
  tanY: number;
  /** (count,6): normal, then its absolute values; the first four are the pyramid's sides. */
  normals: Float64Array;
  count: number;
}

const MAX_NORMALS = 4 + 6 + 24;
const PAD = 1e-12;

/** Frame of a camera without roll: right = direction x up. Straight up or down, right is the world's x axis. */
export function cameraFrame(eye: Vec3, direction: Vec3, out?: CameraFrame): CameraFrame {
  const frame = out ?? { eye: [0, 0, 0], forward: [0, 0, 0], right: [0, 0, 0], up: [0, 0, 0] };
  const length = Math.hypot(direction[0], direction[1], direction[2]);
  const fx = direction[0] / length;
  const fy = direction[1] / length;
  const fz = direction[2] / length;
  const flat = Math.hypot(fx, fz);
  const rx = flat > 0 ? -fz / flat : 1;
  const rz = flat > 0 ? fx / flat : 0;
  set(frame.eye, eye[0], eye[1], eye[2]);
  set(frame.forward, fx, fy, fz);
  set(frame.right, rx, 0, rz);
  set(frame.up, -rz * fy, rz * fx - rx * fz, rx * fy);
  return frame;
}

export function makeFrustum(): Frustum {
  return {
    eye: [0, 0, 0], forward: [0, 0, -1], right: [1, 0, 0], up: [0, 1, 0], tanX: 1, tanY: 1,
    normals: new Float64Array(6 * MAX_NORMALS), count: 0,
  };
}

const rays = new Float64Array(12);

/** Fills `out` for a camera; fov is vertical. No allocation. */
export function setFrustum(out: Frustum, frame: CameraFrame, fovDeg: number, aspect: number): Frustum {
  const { forward: f, right: r, up: u } = frame;
  set(out.eye, frame.eye[0], frame.eye[1], frame.eye[2]);
  set(out.forward, f[0], f[1], f[2]);
  set(out.right, r[0], r[1], r[2]);
  set(out.up, u[0], u[1], u[2]);
  out.tanY = Math.tan((fovDeg * Math.PI) / 360);
  out.tanX = out.tanY * aspect;
  out.count = 0;
  const { tanX, tanY } = out;
  push(out, tanX * f[0] - r[0], tanX * f[1] - r[1], tanX * f[2] - r[2]);
  push(out, tanX * f[0] + r[0], tanX * f[1] + r[1], tanX * f[2] + r[2]);
  push(out, tanY * f[0] - u[0], tanY * f[1] - u[1], tanY * f[2] - u[2]);
  push(out, tanY * f[0] + u[0], tanY * f[1] + u[1], tanY * f[2] + u[2]);
  for (let i = 0; i < 4; i++) {
    const sx = i & 1 ? tanX : -tanX;
    const sy = i & 2 ? tanY : -tanY;
    for (let a = 0; a < 3; a++) rays[3 * i + a] = f[a] + sx * r[a] + sy * u[a];
  }
  for (let e = 0; e < 3; e++) {
    pushIfInside(out, e === 0 ? 1 : 0, e === 1 ? 1 : 0, e === 2 ? 1 : 0);
    for (let i = 0; i < 4; i++) {
      const x = rays[3 * i];
      const y = rays[3 * i + 1];
      const z = rays[3 * i + 2];
      if (e === 0) pushIfInside(out, 0, -z, y);
      else if (e === 1) pushIfInside(out, z, 0, -x);
      else pushIfInside(out, -y, x, 0);
    }
  }
  return out;
}

/** Does the box (six numbers at `at`: low, high) meet the pyramid? `boxes` and the eye are in one frame. */
export function boxMeets(frustum: Frustum, boxes: ArrayLike<number>, at: number): boolean {
  const qx = (boxes[at] + boxes[at + 3]) / 2 - frustum.eye[0];
  const qy = (boxes[at + 1] + boxes[at + 4]) / 2 - frustum.eye[1];
  const qz = (boxes[at + 2] + boxes[at + 5]) / 2 - frustum.eye[2];
  const gx = (boxes[at + 3] - boxes[at]) / 2;
  const gy = (boxes[at + 4] - boxes[at + 1]) / 2;
  const gz = (boxes[at + 5] - boxes[at + 2]) / 2;
  const slack = -PAD * (Math.abs(qx) + Math.abs(qy) + Math.abs(qz) + gx + gy + gz);
  const n = frustum.normals;
  for (let k = 0, end = 6 * frustum.count; k < end; k += 6) {
    if (n[k] * qx + n[k + 1] * qy + n[k + 2] * qz + n[k + 3] * gx + n[k + 4] * gy + n[k + 5] * gz < slack) return false;
  }
  return true;
}

/** Is the whole box inside the pyramid? */
export function boxInside(frustum: Frustum, boxes: ArrayLike<number>, at: number): boolean {
  const qx = (boxes[at] + boxes[at + 3]) / 2 - frustum.eye[0];
  const qy = (boxes[at + 1] + boxes[at + 4]) / 2 - frustum.eye[1];
  const qz = (boxes[at + 2] + boxes[at + 5]) / 2 - frustum.eye[2];
  const gx = (boxes[at + 3] - boxes[at]) / 2;
  const gy = (boxes[at + 4] - boxes[at + 1]) / 2;
  const gz = (boxes[at + 5] - boxes[at + 2]) / 2;
  const n = frustum.normals;
  for (let k = 0; k < 24; k += 6) {
    if (n[k] * qx + n[k + 1] * qy + n[k + 2] * qz - n[k + 3] * gx - n[k + 4] * gy - n[k + 5] * gz < 0) return false;
  }
  return true;
}

function push(out: Frustum, x: number, y: number, z: number): void {
  const length = Math.hypot(x, y, z);
  const at = 6 * out.count++;
  const n = out.normals;
  n[at] = x / length;
  n[at + 1] = y / length;
  n[at + 2] = z / length;
  for (let a = 0; a < 3; a++) n[at + 3 + a] = Math.abs(n[at + a]);
}

/** Adds the normal, or its opposite, whichever has the whole cone on the inner side; neither may. */
function pushIfInside(out: Frustum, x: number, y: number, z: number): void {
  const length = Math.hypot(x, y, z);
  if (length < 1e-9) return;
  let least = Infinity;
  let most = -Infinity;
  for (let i = 0; i < 4; i++) {
    const d = (x * rays[3 * i] + y * rays[3 * i + 1] + z * rays[3 * i + 2]) / length;
    least = Math.min(least, d);
    most = Math.max(most, d);
  }
  if (least >= -PAD) push(out, x, y, z);
  else if (most <= PAD) push(out, -x, -y, -z);
}

function set(v: Vec3, x: number, y: number, z: number): void {
  v[0] = x;
  v[1] = y;
  v[2] = z;
}
