/** Keyboard, mouse and touch -> the walker's motion, and keys -> actions. */
import type { Walker } from "./camera";

const SPEED_M_S = 5;
const FAST = 5;
const RADIANS_PER_PX = 0.0035;
const MOTION: Record<string, [number, number, number]> = {
  KeyW: [0, 0, 1], ArrowUp: [0, 0, 1], KeyS: [0, 0, -1], ArrowDown: [0, 0, -1], KeyA: [-1, 0, 0], ArrowLeft: [-1, 0, 0],
  KeyD: [1, 0, 0], ArrowRight: [1, 0, 0], PageUp: [0, 0.3, 0], PageDown: [0, -0.3, 0],
};

export interface Actions {
  key: (key: string) => boolean; // true: taken
  tap: (x: number, y: number) => void; // in [0,1] of the picture, from the top left
  moved: () => void;
}

export class Controls {
  private readonly held = new Set<string>();
  private stick: [number, number] = [0, 0];
  private readonly motion: [number, number, number] = [0, 0, 0]; // right, up, forward
  private readonly walker: Walker;

  constructor(canvas: HTMLCanvasElement, touchStick: SVGElement | null, walker: Walker, actions: Actions) {
    this.walker = walker;
    window.addEventListener("keydown", (e) => {
      const typing = e.target instanceof HTMLInputElement && e.target.type !== "checkbox";
      if (typing || e.ctrlKey || e.metaKey || e.altKey) return;
      if (MOTION[e.code]) {
        this.held.add(e.code);
        e.preventDefault();
      } else if (e.code.startsWith("Shift")) {
        this.held.add("Shift");
      } else if (!e.repeat && actions.key(e.key.length === 1 ? e.key.toLowerCase() : e.key)) {
        e.preventDefault();
      }
    });
    window.addEventListener("keyup", (e) => this.held.delete(e.code.startsWith("Shift") ? "Shift" : e.code));
    window.addEventListener("blur", () => this.held.clear());

    let down: { x: number; y: number; far: number } | null = null;
    canvas.addEventListener("pointerdown", (e) => {
      if (e.button !== 0) return;
      down = { x: e.clientX, y: e.clientY, far: 0 };
      canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", (e) => {
      if (!down) return;
      const dx = e.clientX - down.x;
      const dy = e.clientY - down.y;
      down = { x: e.clientX, y: e.clientY, far: down.far + Math.abs(dx) + Math.abs(dy) };
      walker.turn(dx * RADIANS_PER_PX, dy * RADIANS_PER_PX);
      actions.moved();
    });
    const up = (e: PointerEvent): void => {
      if (down && down.far < 4 && e.type === "pointerup") {
        const r = canvas.getBoundingClientRect();
        actions.tap((e.clientX - r.left) / r.width, (e.clientY - r.top) / r.height);
      }
      down = null;
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    if (touchStick) this.followStick(touchStick);
  }

  private followStick(stick: SVGElement): void {
    const knob = stick.querySelector(".knob");
    const place = (x: number, y: number): void => {
      this.stick = [x, y];
      knob?.setAttribute("transform", `translate(${26 * x} ${26 * y})`);
    };
    stick.addEventListener("pointerdown", (e) => stick.setPointerCapture(e.pointerId));
    stick.addEventListener("pointermove", (e) => {
      if (!stick.hasPointerCapture(e.pointerId)) return;
      const r = stick.getBoundingClientRect();
      const x = (2 * (e.clientX - r.left)) / r.width - 1;
      const y = (2 * (e.clientY - r.top)) / r.height - 1;
      const length = Math.max(1, Math.hypot(x, y));
      place(x / length, y / length);
    });
    for (const kind of ["pointerup", "pointercancel"]) stick.addEventListener(kind, () => place(0, 0));
  }

  /** Advances the walker by the keys and the stick held; returns whether it moves. */
  advance(seconds: number): boolean {
    const { motion } = this;
    motion[0] = this.stick[0];
    motion[1] = 0;
    motion[2] = -this.stick[1];
    for (const code of this.held) if (MOTION[code]) for (let a = 0; a < 3; a++) motion[a] += MOTION[code][a];
    const length = Math.hypot(motion[0], motion[1], motion[2]);
    const speed = length > 0 ? (SPEED_M_S * (this.held.has("Shift") ? FAST : 1)) / Math.max(1, length) : 0;
    this.walker.move(motion[0] * speed, motion[1] * speed, motion[2] * speed, seconds);
    return length > 0;
  }
}
