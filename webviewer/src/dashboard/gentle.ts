/** Asks again and again, gently: not while nobody looks, and rarer while nobody answers. What was read stays, dated. */
import { explain, Refused } from "../api/client";
import { h } from "./element";
import { failed, note, showLine, skeleton } from "./frame";
import { pauseMs } from "./pause";

export interface Asked<T> {
  ask: () => Promise<T>;
  show: (told: T) => void;
  everyMs: number;
  /** What could not be read: "The workers cannot be read". */
  failure: string;
  /** What to say where the key may not see this. */
  forbidden: () => Node;
}

/** Draws into `body` what `show` makes of each answer; resolves after the first. */
export async function follow<T>(body: HTMLElement, says: HTMLElement, asked: Asked<T>): Promise<void> {
  let failures = 0;
  let lostAtMs = 0;
  let loaded = false;
  let timer: ReturnType<typeof setTimeout> | undefined;
  const loading = skeleton(6, body);
  const again = async (): Promise<void> => {
    clearTimeout(timer);
    timer = undefined;
    try {
      const told = await asked.ask();
      loading.stop();
      failures = lostAtMs = 0;
      loaded = true;
      showLine(true);
      says.replaceChildren();
      asked.show(told);
    } catch (error) {
      loading.stop();
      if (error instanceof Refused && error.status === 401) return location.reload(); // the session is over
      if (error instanceof Refused && error.status === 403) return body.replaceChildren(asked.forbidden());
      failures++;
      lostAtMs ||= Date.now();
      showLine(false, lostAtMs);
      says.className = loaded ? "toast" : "";
      if (!loaded) failed(says, error, asked.failure, () => void again());
      else {
        const told = `Not live: ${explain(error).text}`;
        says.replaceChildren(note("inf", "infeas", told, "What you see was read before. It is tried again by itself.", h("button", { type: "button", onclick: () => void again() }, "Try now")));
      }
    }
    clearTimeout(timer);
    if (!document.hidden) timer = setTimeout(() => void again(), pauseMs(asked.everyMs, failures));
  };
  document.addEventListener("visibilitychange", () => {
    clearTimeout(timer);
    if (!document.hidden) void again();
  });
  await again();
}

export function forbidden(what: string): Node {
  return note("idle", "queue", "For the operator", `${what} of the whole service are shown to keys of the operator's tenant that have the scope admin. Yours has not: sign out and use such a key, or ask who runs the service.`);
}
