/** /workers: who computes, what on, how much of the time, and what went wrong. */
import { listWorkers } from "../api/client";
import type { Worker, WorkerPage } from "../api/types";
import { bytes, count } from "../ui/format";
import { h, refill, scroller } from "./element";
import { main, openPage } from "./frame";
import { ago, duration, plural } from "./format";
import { follow, forbidden } from "./gentle";
import { icon, stateMark } from "./icons";
import { csvButton } from "./report_parts";
import { busyShare, renderer, spread, unserved } from "./worker_facts";

const EVERY_MS = 5000; // workers tell of themselves as often

const MARK: Record<Worker["state"], [kind: string, shape: string]> = { busy: ["run", "run"], idle: ["idle", "queue"], silent: ["inf", "infeas"], stopped: ["idle", "cancel"] };
const HEAD: [name: string, end: boolean][] = [["State", false], ["Worker", false], ["Queues", false], ["Can do", false], ["Current shard", false], ["Busy", true], ["Shards a minute", true], ["Done", true], ["Failed", true], ["Last heartbeat", true]];

await openPage([["↑ ↓", "scroll"]]);
const says = h("div", { role: "status" });
const body = h("div");
main.replaceChildren(h("div", { class: "head" }, h("div", null, h("h1", null, "Workers"), h("p", { class: "small q2" }, "Whoever computes: one shard at a time each. Any of them may be stopped at any time, another goes on."))), says, body);

const queues = h("ul", { class: "tiles" });
const warning = h("div", { role: "status" });
const rows = h("tbody");
const held = new Map<string, HTMLTableRowElement>();
let last: WorkerPage = { workers: [], queues: {} };
const save = csvButton("workers", ["worker", "host", "state", "queues", "cores", "memory_bytes", "version", "renderer", "stage", "shard", "shard_s", "done", "failed", "shards_per_minute", "busy_seconds", "silent_s"],
  () => last.workers.map((w) => [w.name, w.host, w.state, w.queues.join(" "), w.capability.cores, w.capability.memory_bytes, w.capability.version, w.capability.renderer, w.stage, w.shard, w.shard_s, w.done, w.failed, w.shards_per_minute, w.busy_seconds, w.silent_s]));
const table = h("table", { class: "ops" }, h("caption", { class: "sr" }, "Workers, those that work first"),
  h("thead", null, h("tr", null, ...HEAD.map(([name, end]) => h("th", { scope: "col", class: end ? "r" : null }, name)))), rows);
const panel = h("section", { class: "panel", "aria-labelledby": "wh" }, h("header", null, h("h2", { id: "wh" }, "Who is there"), h("span", { class: "small q", id: "spread" }), h("div", { class: "end" }, save)),
  scroller(table));

await follow(body, says, { ask: listWorkers, show, everyMs: EVERY_MS, failure: "The workers cannot be read", forbidden: () => forbidden("The workers") });

function show(told: WorkerPage): void {
  last = told;
  if (!told.workers.length) {
    body.replaceChildren(h("section", { class: "panel empty" }, h("header", null, h("h2", null, "No worker has told of itself")),
      h("p", { class: "q2" }, "Jobs are accepted and wait until one does. Start one on any machine that reaches the database and the artifact store:"),
      h("pre", { class: "mono" }, "python -m farfield_workers cpu,optimizer,gl")));
    return;
  }
  if (!panel.isConnected) body.replaceChildren(queues, warning, panel);
  refill(queues, JSON.stringify(told.queues), () => Object.entries(told.queues).map(([queue, n]) => h("li", { class: n ? null : "none" }, h("b", null, count(n)), h("span", null, n === 1 ? `works on ${queue}` : `work on ${queue}`))));
  const without = unserved(told);
  refill(warning, without.join(" "), () => (without.length ? [h("div", { class: "note inf" }, stateMark("inf", "infeas", `Nobody works on ${without.join(", ")}`),
    h("p", null, "Shards of these queues wait. Start a worker for them, or look into the log of one that has stopped: mostly it is the image, the address of the database, or memory."))] : []));
  document.getElementById("spread")!.textContent = spread(told.workers);
  const shown = told.workers.map((worker) => {
    let row = held.get(worker.name);
    if (!row) held.set(worker.name, (row = h("tr", null, ...HEAD.map(([, end]) => h("td", { class: end ? "r nw" : null })))));
    fill(row, worker);
    return row;
  });
  for (const name of [...held.keys()]) if (!told.workers.some((w) => w.name === name)) held.delete(name);
  shown.forEach((row, k) => rows.rows[k] !== row && rows.insertBefore(row, rows.rows[k] ?? null));
  while (rows.rows.length > shown.length) rows.rows[rows.rows.length - 1].remove();
}

function fill(row: HTMLTableRowElement, w: Worker): void {
  const [kind, shape] = MARK[w.state];
  const busy = busyShare(w);
  const rest = (text: string): HTMLElement => h("small", { class: "q" }, text);
  const contents: (Node | string | null)[][] = [
    [stateMark(kind, shape, w.state)],
    [h("span", { class: "mono" }, w.name), h("br"), rest(w.host)],
    [w.queues.join(", ")],
    [[plural(w.capability.cores ?? 0, "core"), w.capability.memory_bytes ? bytes(w.capability.memory_bytes) : ""].filter(Boolean).join(", "), h("br"), rest(renderer(w))],
    w.shard ? [h("b", null, w.stage ?? "a shard"), ` for ${duration(w.shard_s ?? 0)}`, h("br"), h("small", { class: "q mono" }, w.shard.slice(0, 8))] : [h("span", { class: "q" }, "none")],
    busy === null ? ["—"] : [`${Math.round(100 * busy)} %`, h("i", { class: "prop", css: { "--at": `${100 * busy}%` } })],
    [w.shards_per_minute.toFixed(1)],
    [count(w.done)],
    w.failed ? [h("b", { class: "fail" }, icon("fail"), ` ${count(w.failed)}`)] : ["0"],
    [h("span", w.state === "silent" ? { class: "over" } : null, w.silent_s < 10 ? "just now" : ago(Date.now() - 1000 * w.silent_s, Date.now()))],
  ];
  contents.forEach((content, k) => refill(row.cells[k], content.map((c) => (c instanceof Element ? c.outerHTML : String(c))).join(""), () => content));
}
