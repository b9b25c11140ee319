/** Times, digests and budgets as people read them; bytes, counts and costs are in ui/format. */

/** 0.94 -> "0.9 s", 62 -> "1 min 02 s", 4320 -> "1 h 12 min" */
export function duration(seconds: number): string {
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  const s = Math.round(seconds);
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, "0")} s`;
  return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, "0")} min`;
}

/** 480, 780 -> "8 to 13 min"; rounded outwards. */
export function timeRange(low: number, high: number): string {
  const [divisor, unit] = high < 90 ? [1, "s"] : high < 5400 ? [60, "min"] : [3600, "h"];
  const step = unit === "s" ? 5 : unit === "h" ? 0.5 : 1;
  const a = Math.floor(low / divisor / step) * step;
  const b = Math.max(Math.ceil(high / divisor / step) * step, step);
  return a >= b ? `about ${b} ${unit}` : a <= 0 ? `up to ${b} ${unit}` : `${a} to ${b} ${unit}`;
}

/** "14 min ago" */
export function ago(thenMs: number, nowMs: number): string {
  const s = Math.max(0, (nowMs - thenMs) / 1000);
  if (s < 60) return "just now";
  if (s < 3600) return `${Math.floor(s / 60)} min ago`;
  if (s < 86400) return `${Math.floor(s / 3600)} h ago`;
  return `${Math.floor(s / 86400)} d ago`;
}

/** Clock time of the reader: "12:41:07", with milliseconds on request. */
export function clock(ms: number, millis = false): string {
  const d = new Date(ms);
  const text = [d.getHours(), d.getMinutes(), d.getSeconds()].map((n) => String(n).padStart(2, "0")).join(":");
  return millis ? `${text}.${String(d.getMilliseconds()).padStart(3, "0")}` : text;
}

/** "4b1e…9c07" */
export function shortDigest(digest: string): string {
  return digest.length > 12 ? `${digest.slice(0, 4)}…${digest.slice(-4)}` : digest;
}

/** Job ids are 32 hex digits: the first eight tell them apart. */
export function shortId(id: string): string {
  return id.slice(0, 8);
}

/** Up to `digits` significant places after the point, none that say nothing: 1500, 84.6, 0.25 */
export function metres(x: number): string {
  const digits = Math.abs(x) >= 100 ? 0 : Math.abs(x) >= 10 ? 1 : 2;
  return x.toFixed(digits).replace(/\.?0+$/, (zeros) => (zeros.startsWith(".") ? "" : zeros));
}

export function plural(n: number, one: string, many = `${one}s`): string {
  return `${new Intl.NumberFormat("en").format(n)} ${n === 1 ? one : many}`;
}

/** Joins what is there into sentences. */
export function sentences(...parts: (string | null | undefined)[]): string {
  return parts.filter(Boolean).map((p) => (/[.!?…]$/.test(p!) ? p! : `${p!}.`)).join(" ");
}

export interface BudgetParts {
  amount: number;
  unit: "ms" | "calls" | "triangles";
}

/** "16 ms" -> 16, ms; null where it is no budget. The same form as `farfield.settings.parse_budget`. */
export function parseBudget(text: string): BudgetParts | null {
  const match = /^\s*([0-9][0-9_]*(?:\.[0-9]+)?)\s*(ms|calls?|triangles?)\s*$/.exec(text);
  if (!match) return null;
  const amount = Number(match[1].replaceAll("_", ""));
  return { amount, unit: match[2] === "ms" ? "ms" : match[2].startsWith("call") ? "calls" : "triangles" };
}
