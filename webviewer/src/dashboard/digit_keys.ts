/** Numbers of up to two digits from single keys: the first digit counts at once, a second one soon after makes it two. */

const SOON_MS = 900;

export class DigitKeys {
  private first = 0;
  private atMs = -Infinity;

  /** The number that is meant by this digit, pressed now; 0 where there is none up to `most`. */
  press(digit: number, nowMs: number, most: number): number {
    const both = 10 * this.first + digit;
    if (this.first > 0 && nowMs - this.atMs <= SOON_MS && both <= most) {
      this.first = 0;
      return both;
    }
    this.first = digit;
    this.atMs = nowMs;
    return digit <= most ? digit : 0;
  }
}
