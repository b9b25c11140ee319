/** What may change many times a second is drawn at most four times. */

const REDRAW_MS = 250;

export class Redraw {
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly draw: () => void) {}

  soon(): void {
    this.timer ??= setTimeout(() => {
      this.done();
      this.draw();
    }, REDRAW_MS);
  }

  /** Somebody draws right now: what was due is part of it. */
  done(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
  }
}
