/** /devices: what drawing costs, on which device; the device at hand is measured here. */
import { deleteDevice, explain, listDevices } from "../api/client";
import type { DeviceProfile } from "../api/schema";
import type { Device, DevicePage } from "../api/types";
import { count } from "../ui/format";
import { h, scroller } from "./element";
import { confirmed, failed, main, note, onKey, openPage, skeleton } from "./frame";
import { ago } from "./format";
import { MeasurePanel } from "./measure_panel";
import { csvButton } from "./report_parts";

const COSTS: [key: keyof DeviceProfile, name: string][] = [
  ["per_frame_ns", "A frame"], ["per_call_ns", "A call"], ["per_triangle_ns", "A triangle"], ["per_pixel_ns", "A pixel"],
  ["per_impostor_ns", "An impostor"], ["per_impostor_triangle_ns", "Its triangle"], ["per_impostor_pixel_ns", "Its pixel"],
];

const session = await openPage([["M", "measure this device, or stop"]]);
const says = h("div", { role: "status" });
const list = h("div");
const measure = new MeasurePanel(session.scopes.includes("submit"), () => void refresh());
onKey("m", () => measure.toggle());
main.replaceChildren(h("div", { class: "head" }, h("div", null, h("h1", null, "Devices"),
  h("p", { class: "small q2" }, "A budget in milliseconds is counted on a device: what a frame, a call, a triangle and a pixel cost there. A job names one."))), says, measure.element, list);
const loading = skeleton(6, list);
await refresh();
loading.stop();
if (location.hash === "#measure") measure.focus();

async function refresh(): Promise<void> {
  try {
    show(await listDevices());
  } catch (error) {
    failed(list, error, "The devices cannot be read", () => void refresh());
  }
}

function show({ presets, devices }: DevicePage): void {
  const rows = [...devices.map((d) => ({ name: d.name, profile: d.profile as DeviceProfile | null, device: d as Device | null })), ...presets.map((p) => ({ name: p.name, profile: p.profile as unknown as DeviceProfile, device: null }))];
  measure.known(devices, presets.map((p) => p.name));
  const table = h("table", { class: "num devs" }, h("caption", { class: "sr" }, "Devices, yours first, then what every service knows"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Device"), ...COSTS.map(([, name]) => h("th", { scope: "col", class: "r" }, name)), h("th", { scope: "col" }, "Fit"), h("th", null, h("span", { class: "sr" }, "Delete")))),
    h("tbody", null, ...rows.map(({ name, profile, device }) => h("tr", null,
      h("th", { scope: "row" }, name, h("small", { class: "q" }, device ? `${count(device.samples)} frames, ${ago(Date.parse(device.created_at), Date.now())}` : "preset, not measured")),
      ...(profile ? COSTS.map(([key]) => h("td", { class: "r nw" }, nanoseconds(Number(profile[key])))) : [h("td", { class: "q2", colspan: COSTS.length }, device?.missing?.detail ?? "No frame was measured yet: choose its name above and measure.")]),
      h("td", null, fitOf(profile)),
      h("td", { class: "r" }, device && session.scopes.includes("submit") ? h("button", { class: "btn plain", type: "button", "aria-label": `Delete ${name}`, onclick: () => void remove(device) }, "Delete") : null)))));
  const save = csvButton("devices", ["device", "samples", ...COSTS.map(([key]) => key)], () => rows.map(({ name, profile, device }) => [name, device?.samples ?? null, ...COSTS.map(([key]) => (profile ? Number(profile[key]) : null))]));
  list.replaceChildren(h("section", { class: "panel", "aria-labelledby": "dh" }, h("header", null, h("h2", { id: "dh" }, "What drawing costs"), h("span", { class: "small q" }, "upper bounds; jobs keep the figures they were made with"), h("div", { class: "end" }, save)), scroller(table)));
}

function fitOf(profile: DeviceProfile | null): string {
  const fit = profile?.fit;
  return fit ? `${fit.mean_ms.toFixed(1)} ms above on the mean; ${(100 * fit.unseen_under_share).toFixed(0)} % of unseen frames took longer` : "";
}

/** 10000 -> "10 µs", 0.05 -> "0.05 ns" */
function nanoseconds(ns: number): string {
  const short = (v: number): string => String(Number(v.toPrecision(3)));
  return ns >= 1e6 ? `${short(ns / 1e6)} ms` : ns >= 1e3 ? `${short(ns / 1e3)} µs` : `${short(ns)} ns`;
}

async function remove(device: Device): Promise<void> {
  if (!(await confirmed(`Delete ${device.name}?`, "Its frames go with it. Jobs keep the figures they were made with.", "Delete the device", "Keep it"))) return;
  try {
    await deleteDevice(device.id);
    says.replaceChildren();
    await refresh();
  } catch (error) {
    says.replaceChildren(note("bad", "fail", "Not deleted", explain(error).text));
  }
}
