/** One view of a frame: the camera, its projection, and what kind of picture is drawn. */
import type { CameraFrame } from "../select/frustum";
import type { Vec3 } from "../placementdb/manifest";

export const PICTURE = 0;
export const TINTED = 1;
export const IDS = 2;
export const HEAT = 3; // texels a pixel
export type Mode = typeof PICTURE | typeof TINTED | typeof IDS | typeof HEAT;

export interface View {
  frame: CameraFrame; // scene metres
  near: number;
  far: number;
  tanX: number;
  tanY: number;
  mode: Mode;
  /** Rotation into camera axes and projection, column by column, without translation. */
  viewProjection: Float32Array;
}

export function makeView(): View {
  return {
    frame: { eye: [0, 0, 0], forward: [0, 0, -1], right: [1, 0, 0], up: [0, 1, 0] },
    near: 0.1, far: 1000, tanX: 1, tanY: 1, mode: PICTURE, viewProjection: new Float32Array(16),
  };
}

export function setViewProjection(view: View): void {
  const { frame, tanX, tanY, near, far, viewProjection: m } = view;
  const a = (far + near) / (far - near);
  const b = (-2 * far * near) / (far - near);
  for (let k = 0; k < 3; k++) {
    m[4 * k] = frame.right[k] / tanX;
    m[4 * k + 1] = frame.up[k] / tanY;
    m[4 * k + 2] = a * frame.forward[k];
    m[4 * k + 3] = frame.forward[k];
  }
  m[12] = m[13] = m[15] = 0;
  m[14] = b;
}

/** Far plane that holds the whole level, seen from the eye. */
export function farthest(eye: Vec3, bounds: readonly [Vec3, Vec3] | null): number {
  if (!bounds) return 1000;
  let sum = 0;
  for (let a = 0; a < 3; a++) sum += Math.max(Math.abs(bounds[0][a] - eye[a]), Math.abs(bounds[1][a] - eye[a])) ** 2;
  return Math.max(10, Math.sqrt(sum) * 1.01);
}
