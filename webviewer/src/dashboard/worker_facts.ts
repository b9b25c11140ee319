/** What a list of workers amounts to. */
import type { Worker, WorkerPage } from "../api/types";

const LIVES = (w: Worker): boolean => w.state === "busy" || w.state === "idle";

/** Share of its life that a worker computed; null where it has not lived for a second. */
export function busyShare(w: Worker): number | null {
  const lived = (Date.parse(w.heartbeat_at) - Date.parse(w.started_at)) / 1000;
  return lived >= 1 ? Math.min(1, w.busy_seconds / lived) : null;
}

/** Queues that no living worker takes from. */
export function unserved(told: WorkerPage): string[] {
  return Object.entries(told.queues).filter(([, n]) => n === 0).map(([queue]) => queue);
}

/** "2 busy, 1 idle, 14.2 shards a minute" */
export function spread(workers: readonly Worker[]): string {
  const words = (["busy", "idle", "silent", "stopped"] as const).map((state) => [workers.filter((w) => w.state === state).length, state] as const).filter(([n]) => n > 0).map(([n, state]) => `${n} ${state}`);
  const pace = workers.filter(LIVES).reduce((sum, w) => sum + w.shards_per_minute, 0);
  return [...words, `${pace.toFixed(1)} shards a minute`].join(", ");
}

/** The renderer is known once a worker has made its context; one that never bakes has none. */
export function renderer(w: Worker): string {
  return w.capability.renderer ?? (w.queues.includes("gl") ? "renderer not asked yet" : "does not bake");
}
