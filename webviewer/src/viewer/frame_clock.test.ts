import { expect, test } from "vitest";
import { FrameClock } from "./frame_clock";

/** A GPU whose timer tells `ms` of each frame once `done` is set; without `timer` one that has none. */
function gpu(state: { done: boolean; ms: number }, timer = true): WebGL2RenderingContext {
  return {
    getExtension: () => (timer ? { TIME_ELAPSED_EXT: 1, GPU_DISJOINT_EXT: 2 } : null),
    createQuery: () => ({}), beginQuery: () => {}, endQuery: () => {}, getParameter: () => false,
    QUERY_RESULT_AVAILABLE: 3, QUERY_RESULT: 4,
    getQueryParameter: (_: unknown, what: number) => (what === 3 ? state.done : state.ms * 1e6),
  } as unknown as WebGL2RenderingContext;
}

function frame(clock: FrameClock): void {
  clock.begin();
  clock.end(1, 2, false);
}

test("a frame's time is not stated before the GPU has told it", () => {
  const state = { done: false, ms: 1234 };
  const clock = new FrameClock(gpu(state));
  for (let k = 0; k < 12; k++) frame(clock); // more than wait at a time: some are never timed
  expect(clock.median()).toBeNull();
  state.done = true;
  clock.collect();
  expect(clock.median()).toBe(1234);
  state.done = false;
  frame(clock);
  expect(clock.median()).toBe(1234);
});

test("without a timer the interval between frames is the time", () => {
  const clock = new FrameClock(gpu({ done: true, ms: 0 }, false));
  expect(clock.median()).toBeNull();
  frame(clock);
  expect(clock.median()).not.toBeNull();
});
