/** Cost over budget in nine classes; the break at 1 is sharp: classes 5 and up are over budget, nothing else is. */

export const BREAKS = [0.35, 0.5, 0.7, 0.9, 1, 1.25, 1.6, 2.2];

export function classOf(cost: number, budget: number): number {
  // Compared as integers times one float each: cost = budget is within budget, whatever the division would round to.
  let k = 0;
  while (k < BREAKS.length && (BREAKS[k] === 1 ? cost > budget : cost > BREAKS[k] * budget)) k++;
  return k;
}
