/** The settings of a new job: what was suggested and why, each of them to be changed; only what was changed is sent. */
import { listDevices } from "../api/client";
import type { Settings } from "../api/schema";
import type { Scene } from "../api/types";
import { h } from "./element";
import { metres, parseBudget } from "./format";

const DEVICE = "reference"; // of services/farfield/settings.py
const INTERVALS = ["90", "45", "22.5", "11.25", "5.625"];

export class SettingsForm {
  readonly fields: HTMLElement[];
  private readonly amount: HTMLInputElement;
  private readonly unit: HTMLSelectElement;
  private readonly inputs: Record<string, HTMLInputElement | HTMLSelectElement> = {};
  private readonly errors = new Map<string, HTMLElement>();
  private readonly base: Settings;
  private readonly order = h("select", { id: "s-priority" }, ...["high", "normal", "low"].map((word) => h("option", { selected: word === "normal" }, word)));

  /** `base` are settings to start from: those of the job that is run again, or none. */
  constructor(scene: Scene, base: Settings) {
    this.base = base;
    const suggested = scene.suggested;
    const why = suggested?.why ?? {};
    const budget = parseBudget(base.budget ?? suggested?.budgets[0] ?? "16 ms") ?? { amount: 16, unit: "ms" as const };
    this.amount = h("input", { id: "s-budget", type: "text", inputmode: "decimal", value: budget.amount, "aria-describedby": "s-budget-why" });
    this.unit = h("select", { "aria-label": "Unit of the budget" }, ...["ms", "calls", "triangles"].map((u) => h("option", { selected: u === budget.unit }, u)));
    this.inputs["budget"] = this.amount;
    const others = (suggested?.budgets ?? []).map((text) => h("button", { class: "btn plain", type: "button", onclick: () => this.setBudget(text) }, text));
    const fields: HTMLElement[] = [
      h("label", { for: "s-budget" }, "Budget of a frame", h("small", { id: "s-budget-why" }, why["budgets"] ?? "")),
      h("div", { class: "u pair-in" }, this.amount, this.unit),
    ];
    if (others.length > 1) fields.push(h("div", { class: "sugg wide" }, ...others));
    fields.push(this.error("budget"));
    const cell = base.view_space?.cell_m ?? suggested?.view_space.cell_m;
    fields.push(...this.number("view_space.cell_m", "View-space cell", why["view_space.cell_m"] ?? "derived from the level", cell == null ? "" : metres(cell), "m"));
    const interval = String(base.view_space?.interval_deg ?? suggested?.view_space.interval_deg ?? 11.25);
    const select = h("select", { id: "s-view_space.interval_deg" }, ...INTERVALS.map((v) => h("option", { value: v, selected: v === interval }, `${v}°`)));
    this.inputs["view_space.interval_deg"] = select;
    fields.push(h("label", { for: select.id }, "Direction interval", h("small", null, why["view_space.interval_deg"] ?? "")), select, this.error("view_space.interval_deg"));
    fields.push(...this.number("quality.pixel_error", "Pixel error", "largest parallax, at the screen's centre", String(base.quality?.pixel_error ?? 1), "px"));
    fields.push(...this.number("camera.fov_deg", "Field of view", "vertical", String(base.camera?.fov_deg ?? 45), "°"));
    fields.push(...this.number("camera.width", "Picture width", "the largest that the guarantee holds for", String(base.camera?.width ?? 1280), "px"));
    fields.push(...this.number("camera.height", "Picture height", "", String(base.camera?.height ?? 720), "px"));
    fields.push(...this.target(base));
    this.fields = fields;
    for (const input of Object.values(this.inputs)) input.dataset.was = input.value;
  }

  /** What the budget's milliseconds are counted on, and before which other jobs this one runs. */
  private target(base: Settings): HTMLElement[] {
    const named = base.device ?? DEVICE;
    const device = h("select", { id: "s-device" }, h("option", { value: named, selected: true }, named));
    this.inputs["device"] = device;
    const fields = [h("label", { for: device.id }, "Device", h("small", null, "what a budget in ms is counted on")), device, this.error("device")];
    void listDevices().then(({ presets, devices }) => {
      const known = new Set([named]);
      const option = (name: string, text: string, disabled = false): HTMLElement | null => (known.has(name) ? null : (known.add(name), h("option", { value: name, disabled }, text)));
      device.append(...presets.map((p) => option(p.name, p.name)).filter((o) => o !== null));
      const own = devices.map((d) => option(d.name, d.profile ? d.name : `${d.name}: needs more samples`, d.profile === null)).filter((o) => o !== null);
      if (own.length) device.append(h("optgroup", { label: "Measured" }, ...own));
    }, () => undefined); // the one that it starts with can be used all the same
    return [...fields, h("label", { for: this.order.id }, "Priority", h("small", null, "before or after your other jobs")), this.order];
  }

  get priority(): "high" | "normal" | "low" {
    return this.order.value as "high" | "normal" | "low";
  }

  private number(key: string, label: string, why: string, value: string, unit: string): HTMLElement[] {
    const input = h("input", { id: `s-${key}`, type: "text", inputmode: "decimal", value });
    this.inputs[key] = input;
    return [h("label", { for: input.id }, label, why ? h("small", null, why) : null), h("div", { class: "u" }, input, h("span", null, unit)), this.error(key)];
  }

  private error(key: string): HTMLElement {
    const box = h("p", { class: "err", role: "alert", hidden: true });
    this.errors.set(key, box);
    return box;
  }

  private setBudget(text: string): void {
    const parts = parseBudget(text);
    if (!parts) return;
    this.amount.value = String(parts.amount);
    this.unit.value = parts.unit;
    this.amount.focus();
  }

  /** The settings as they stand; null where a field holds no number, which is then marked. */
  read(): Settings | null {
    this.clear();
    const settings = structuredClone(this.base) as Record<string, unknown>;
    settings["budget"] = `${this.amount.value.trim().replace(",", ".")} ${this.unit.value}`;
    if (!parseBudget(settings["budget"] as string)) return this.refuse("budget", "a number, such as 16 or 1300");
    for (const [key, input] of Object.entries(this.inputs)) {
      if (key === "budget" || input.value === input.dataset.was) continue;
      if (key === "device") {
        settings["device"] = input.value;
        delete settings["device_profile"]; // the figures of the device before
        continue;
      }
      const text = input.value.trim().replace(",", ".");
      if (text === "" || !Number.isFinite(Number(text))) return this.refuse(key, "a number");
      const [group, name] = key.split(".");
      settings[group] = { ...(settings[group] as object | undefined), [name]: Number(text) };
    }
    return settings as Settings;
  }

  /** Shows what the service says of a setting; false where the form has no such field. */
  mark(key: string, text: string): boolean {
    const known = this.inputs[key];
    if (!known) return false;
    known.setAttribute("aria-invalid", "true");
    const box = this.errors.get(key)!;
    box.textContent = text;
    box.hidden = false;
    known.focus();
    return true;
  }

  private refuse(key: string, wanted: string): null {
    this.mark(key, `Needs ${wanted}.`);
    return null;
  }

  private clear(): void {
    for (const input of Object.values(this.inputs)) input.removeAttribute("aria-invalid");
    for (const box of this.errors.values()) box.hidden = true;
  }
}
