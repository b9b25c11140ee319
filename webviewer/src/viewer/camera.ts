/** The walker: a position in the view space and a direction; no roll, no zoom. */
import { clampToBoxes, insideBoxes } from "../select/clamp";
import type { Box, Vec3 } from "../placementdb/manifest";

const STEEPEST = (89 * Math.PI) / 180;

export class Walker {
  readonly position: Vec3 = [0, 0, 0];
  yaw = 0; // 0 looks along -z, positive turns left
  pitch = 0;
  free = false;
  /** Metres above the floor of the box the walker is in; kept when the floor changes. */
  height = 0;
  readonly velocity: Vec3 = [0, 0, 0];
  private readonly boxes: readonly Box[];
  private readonly stated: Vec3 = [0, 0, -1];
  private readonly turned: Vec3 = [0, 0, -1];
  private exact = false; // the direction is the stated one

  constructor(boxes: readonly Box[]) {
    this.boxes = boxes;
    // Start in the middle of the box nearest to the middle of all of them.
    const middle: Vec3 = [0, 0, 0];
    for (let a = 0; a < 3; a++) {
      middle[a] = (Math.min(...boxes.map((b) => b[0][a])) + Math.max(...boxes.map((b) => b[1][a]))) / 2;
    }
    const box = boxes[clampToBoxes(boxes, middle, this.position)];
    this.height = Math.min(1.7, (box[1][1] - box[0][1]) / 2);
    this.position[1] = box[0][1] + this.height;
  }

  /** A direction set from outside is used to the last bit until the walker turns. Copy it to keep it: it is written in place. */
  get direction(): Vec3 {
    if (this.exact) return this.stated;
    const { turned } = this;
    const flat = Math.cos(this.pitch);
    turned[0] = -Math.sin(this.yaw) * flat;
    turned[1] = Math.sin(this.pitch);
    turned[2] = -Math.cos(this.yaw) * flat;
    return turned;
  }

  look(position: ArrayLike<number>, direction: ArrayLike<number>): void {
    for (let a = 0; a < 3; a++) this.position[a] = position[a];
    this.velocity.fill(0);
    if (!this.free) {
      const [low] = this.boxes[clampToBoxes(this.boxes, this.position, this.position)];
      this.height = this.position[1] - low[1];
    }
    this.exact = true;
    for (let a = 0; a < 3; a++) this.stated[a] = direction[a];
    const length = Math.hypot(direction[0], direction[1], direction[2]);
    this.pitch = Math.asin(Math.max(-1, Math.min(1, direction[1] / length)));
    this.yaw = Math.atan2(-direction[0], -direction[2]);
  }

  turn(left: number, up: number): void {
    if (!left && !up) return;
    this.exact = false;
    this.yaw += left;
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + up));
  }

  /** Moves by metres per second along (right, up, forward) for some seconds; walking keeps to the ground plane. */
  move(right: number, up: number, forward: number, seconds: number): void {
    const { position, velocity } = this;
    const [x, y, z] = position;
    const s = Math.sin(this.yaw);
    const c = Math.cos(this.yaw);
    const rise = this.free ? Math.sin(this.pitch) : 0;
    const flat = this.free ? Math.cos(this.pitch) : 1;
    this.position[0] += (c * right - s * flat * forward) * seconds;
    this.position[1] += (up + rise * forward) * seconds;
    this.position[2] += (-s * right - c * flat * forward) * seconds;
    if (!this.free && (right || up || forward)) {
      if (up) this.height = Math.max(0, this.height + up * seconds);
      const box = this.standingBox();
      this.height = Math.min(this.height, box[1][1] - box[0][1]);
      this.position[1] = box[0][1] + this.height;
      for (let a = 0; a < 3; a++) position[a] = Math.min(Math.max(position[a], box[0][a]), box[1][a]);
    }
    velocity[0] = seconds > 0 ? (position[0] - x) / seconds : 0;
    velocity[1] = seconds > 0 ? (position[1] - y) / seconds : 0;
    velocity[2] = seconds > 0 ? (position[2] - z) / seconds : 0;
  }

  /** The box under the feet: nearest in the ground plane, then in height. Steps between floors are no obstacle. */
  private standingBox(): Box {
    let best = this.boxes[0];
    let leastFlat = Infinity;
    let leastUp = Infinity;
    for (const box of this.boxes) {
      const x = gap(box, this.position, 0);
      const z = gap(box, this.position, 2);
      const flat = x * x + z * z;
      const up = gap(box, this.position, 1);
      if (flat < leastFlat || (flat === leastFlat && up < leastUp)) {
        best = box;
        leastFlat = flat;
        leastUp = up;
      }
    }
    return best;
  }

  setFree(free: boolean): void {
    this.free = free;
    if (!free) {
      const box = this.boxes[clampToBoxes(this.boxes, this.position, this.position)];
      this.height = this.position[1] - box[0][1];
    }
  }

  get inside(): boolean {
    return insideBoxes(this.boxes, this.position);
  }
}

function gap(box: Box, p: Vec3, axis: number): number {
  return Math.max(box[0][axis] - p[axis], p[axis] - box[1][axis], 0);
}
