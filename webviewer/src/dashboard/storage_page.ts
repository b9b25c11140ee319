/** /storage: what takes the room, what nothing refers to, and each tenant against its quota. */
import { readStorage, readUsage } from "../api/client";
import type { Storage } from "../api/types";
import type { UsageReply } from "../api/schema";
import { bytes, count } from "../ui/format";
import { h, scroller } from "./element";
import { main, openPage } from "./frame";
import { plural } from "./format";
import { follow, forbidden } from "./gentle";
import { progressBar } from "./job_row";
import { csvButton, part } from "./report_parts";

const EVERY_MS = 30_000;
const WORDS: Record<string, [name: string, hint: string]> = {
  scenes: ["Scenes", "as they were sent, with what was read of them"],
  results: ["Results", "of stages: placements and what they are made of"],
  reports: ["Reports", "of jobs"],
  pieces: ["Pieces", "of stages: what the next job need not compute again"],
  unreferenced: ["Unreferenced", "nothing refers to them; they are collected by themselves"],
  other: ["Other", "uploads on their way, and what is just being stored"],
};

await openPage([]);
const says = h("div", { role: "status" });
const mine = h("div");
const body = h("div");
main.replaceChildren(h("div", { class: "head" }, h("div", null, h("h1", null, "Storage"))), says, mine, body);
await readUsage().then((told) => mine.replaceChildren(usagePanel(told)), () => undefined); // the rest says what is wrong
await follow(body, says, { ask: readStorage, show, everyMs: EVERY_MS, failure: "The storage cannot be read", forbidden: () => forbidden("Artifacts and quotas") });

function usagePanel(told: UsageReply): HTMLElement {
  const { quota } = told;
  const bars = [against("Bytes", told.bytes, quota.max_bytes, bytes), against("Jobs", told.jobs, quota.max_jobs, count), against("Jobs queued or running", told.running, quota.max_running, count)];
  return part("uh", "Yours", "what you may have is the operator's to set", null, h("div", { class: "quotas" }, ...bars));
}

/** A figure and its limit, as a bar where there is one. */
function against(name: string, used: number, limit: number | null, text: (n: number) => string): HTMLElement {
  const share = limit ? Math.min(1, used / limit) : 0;
  return h("div", null, h("span", { class: "small q2" }, name), h("div", null, h("b", limit !== null && used >= limit ? { class: "over" } : null, text(used)), h("span", { class: "q" }, limit === null ? ", no limit" : ` of ${text(limit)}`)),
    limit === null ? null : progressBar(used >= limit ? "full" : "", share, [], `${name}: ${text(used)} of ${text(limit)}`));
}

function show(told: Storage): void {
  if (!told.total.artifacts) {
    body.replaceChildren(part("kh", "Nothing is stored yet", "", null, h("p", { class: "q2" }, "The first level that is sent makes the first artifact: ", h("a", { href: "/jobs" }, "start a job"), ".")));
    return;
  }
  const kinds = Object.entries(told.kinds).sort(([, a], [, b]) => b.bytes - a.bytes);
  const most = Math.max(1, ...kinds.map(([, k]) => k.bytes));
  const rows = kinds.map(([kind, k]) => {
    const [name, hint] = WORDS[kind] ?? [kind, ""];
    return h("tr", null, h("th", { scope: "row" }, name, h("small", { class: "q" }, hint)), h("td", { class: "r nw" }, count(k.artifacts)), h("td", { class: "r nw" }, bytes(k.bytes)),
      h("td", { class: "st-bar" }, h("i", { class: `prop${k.bytes ? "" : " off"}${kind === "unreferenced" ? " loose" : ""}`, css: { "--at": `${(100 * k.bytes) / most}%` } })), h("td", { class: "r nw q" }, `${((100 * k.bytes) / Math.max(1, told.total.bytes)).toFixed(1)} %`));
  });
  const head = (...names: string[]): HTMLElement => h("thead", null, h("tr", null, ...names.map((name, k) => h("th", { scope: "col", class: k ? "r" : null }, name))));
  const kindsTable = h("table", { class: "num" }, h("caption", { class: "sr" }, "Artifacts by kind, those that take most first"), head("Kind", "Artifacts", "Bytes", "", "Of all"), h("tbody", null, ...rows));
  (kindsTable.tHead!.rows[0].cells[3] as HTMLElement).append(h("span", { class: "sr" }, "Bytes as a bar"));
  const tenants = h("table", { class: "num" }, h("caption", { class: "sr" }, "Tenants and their quotas"), head("Tenant", "Scenes", "Bytes of scenes", "Jobs", "May store"),
    h("tbody", null, ...told.tenants.map((t) => h("tr", null, h("th", { scope: "row" }, t.name, h("small", { class: "q mono" }, t.tenant.slice(0, 8))), h("td", { class: "r nw" }, count(t.scenes)), h("td", { class: "r nw" }, bytes(t.scene_bytes)), h("td", { class: "r nw" }, count(t.jobs)),
      h("td", { class: "r nw" }, t.max_bytes === null ? h("span", { class: "q" }, "as the service says") : bytes(t.max_bytes))))));
  const loose = told.kinds["unreferenced"];
  body.replaceChildren(
    part("kh", "By kind", `${bytes(told.total.bytes)} in ${plural(told.total.artifacts, "artifact")}`, csvButton("storage", ["kind", "artifacts", "bytes"], () => kinds.map(([kind, k]) => [kind, k.artifacts, k.bytes])), scroller(kindsTable),
      h("p", { class: "small q2" }, loose?.bytes ? `${bytes(loose.bytes)} can go: the reconciler collects them by itself, “farfield gc” does it now.` : "Nothing is kept that is not needed.")),
    part("th", "Tenants", plural(told.tenants.length, "tenant"), csvButton("tenants", ["tenant", "name", "scenes", "scene_bytes", "jobs", "max_bytes"], () => told.tenants.map((t) => [t.tenant, t.name, t.scenes, t.scene_bytes, t.jobs, t.max_bytes])), scroller(tenants)));
}
