/** How long to wait before asking again. */

const LONGEST_MS = 60_000;

/** Wait after `failures` answers in a row that did not come. */
export function pauseMs(everyMs: number, failures: number): number {
  return Math.min(LONGEST_MS, everyMs * 2 ** Math.min(failures, 8));
}
