/** Which rows of a long list are in the document: those in sight, some around them, and the one that has the focus. */

const AROUND = 12;

/**
 * Rows [first, last) of `n` that are `height` px high each, where the list was scrolled by `above` px and `sight` px show.
 * A row with the focus (`focused`, -1: none) keeps its neighbours, so that Tab and arrows go on from it, if it is near.
 */
export function rowWindow(n: number, height: number, above: number, sight: number, focused: number): { first: number; last: number } {
  let first = Math.max(0, Math.min(n, Math.floor(above / height)) - AROUND);
  let last = Math.max(first, Math.min(n, Math.ceil((above + sight) / height) + AROUND));
  if (focused >= 0) {
    first = Math.min(first, Math.max(0, Math.max(focused - 1, first - 4 * AROUND)));
    last = Math.max(last, Math.min(n, Math.min(focused + 2, last + 4 * AROUND)));
  }
  return { first, last };
}
