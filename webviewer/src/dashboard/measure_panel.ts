/** "Measure this device": controlled frames, timed; a fit by the service in between and at the end. three.js comes only then. */
import { createDevice, explain, sendSamples } from "../api/client";
import type { DeviceProfile } from "../api/schema";
import type { Device } from "../api/types";
import { FRAMES, predictedMs, type Sample } from "../calibrate/plan";
import { DevicePlot, type Measured } from "./device_plot";
import { h } from "./element";
import { note } from "./frame";
import { sentences } from "./format";

const SIZES = [[640, 360], [1280, 720], [1920, 1080], [3840, 2160]] as const; // what a frame costs depends on it
const DEFAULT_SIZE = 1; // the default camera's
const FIRST_FIT = 110; // of FRAMES; the frames after it are predicted before they are measured
const NAME_MOST = 100;

export class MeasurePanel {
  readonly element: HTMLElement;
  private readonly name = h("input", { id: "dev-name", type: "text", maxlength: NAME_MOST, autocomplete: "off", required: true, "aria-describedby": "dev-help" });
  private readonly size = h("select", { id: "dev-size", "aria-label": "Size of the picture" }, ...SIZES.map(([w, tall], k) => h("option", { value: k, selected: k === DEFAULT_SIZE }, `${w} × ${tall}`)));
  private readonly button = h("button", { class: "btn primary" }, "Measure this device");
  private readonly bar = h("div", { class: "bar", role: "progressbar", "aria-label": "Frames measured", "aria-valuemin": "0", "aria-valuemax": "100", "aria-valuenow": "0" }, h("i"));
  private readonly status = h("p", { class: "small q2", role: "status" }, "Takes about half a minute. Close other programs that draw, and leave this page in front.");
  private readonly result = h("div", { role: "status" });
  private readonly picture = h("div", { class: "picture" });
  private readonly plot = new DevicePlot();
  private stop: AbortController | null = null;
  private devices: readonly Device[] = [];
  private presets: readonly string[] = [];

  constructor(private readonly allowed: boolean, private readonly changed: () => void) {
    const form = h("form", { class: "measure" }, h("label", { for: "dev-name" }, "Name"), this.name, this.size, this.button,
      h("small", { id: "dev-help", class: "q" }, "What jobs call it. The name of a device that is there adds to its frames."));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.toggle();
    });
    this.name.value = suggestedName();
    if (!allowed) this.button.disabled = true;
    this.element = h("section", { class: "panel", id: "measure", "aria-labelledby": "ms-h" },
      h("header", null, h("h2", { id: "ms-h" }, "Measure this device"), h("span", { class: "small q" }, "controlled frames of the size that jobs ask for, drawn as the viewer draws them")),
      h("div", { class: "two" }, h("div", { class: "col" }, h("div", null, form, this.bar, this.status, this.result), this.picture), this.plot.element));
    if (!allowed) this.status.textContent = "Your key may read only: sign in with one that has the scope submit to store a profile.";
  }

  known(devices: readonly Device[], presets: readonly string[]): void {
    this.devices = devices;
    this.presets = presets;
  }

  focus(): void {
    this.button.focus();
  }

  /** Begins, or ends what has begun: what was measured so far is kept. */
  toggle(): void {
    if (this.stop) return this.stop.abort();
    if (!this.allowed || !this.name.reportValidity()) return;
    const name = this.name.value.trim();
    if (!name || this.presets.includes(name)) {
      this.result.replaceChildren(note("inf", "infeas", name ? `“${name}” is a preset` : "A device needs a name", "Choose another name: jobs use it."));
      return this.name.focus();
    }
    void this.run(name);
  }

  private async run(name: string): Promise<void> {
    const stop = (this.stop = new AbortController());
    this.button.textContent = "Stop";
    this.result.replaceChildren();
    const [width, height] = SIZES[Number(this.size.value)];
    const canvas = h("canvas", { width, height, role: "img", "aria-label": "The frames that are being measured" });
    this.picture.replaceChildren(canvas);
    const points: Measured[] = [];
    const began = Date.now();
    const key = `${began}-${Math.random().toString(36).slice(2)}`;
    let bench: { dispose: () => void } | null = null;
    try {
      const { Bench } = await import("../calibrate/bench");
      const made = new Bench(canvas);
      bench = made;
      let device = this.devices.find((d) => d.name === name) ?? null;
      let sent = 0;
      let profile: DeviceProfile | null = null;
      const fit = async (): Promise<Device> => {
        const fresh: Sample[] = points.slice(sent).map(({ predictedMs: _, seen: __, ...sample }) => sample);
        device ??= await createDevice(name);
        const told = await sendSamples(device.id, fresh, `${key}-${sent}`);
        sent = points.length;
        profile = told.profile as DeviceProfile | null;
        for (const p of points) if (profile) [p.predictedMs, p.seen] = [predictedMs(p, profile), true];
        this.plot.show([...points]);
        return told;
      };
      for await (const sample of made.measure(stop.signal, (share) => this.tell(share * 0.15, `Finding out what this device can do (${made.timed})`))) {
        points.push({ ...sample, predictedMs: profile && predictedMs(sample, profile), seen: false });
        this.plot.show([...points]);
        this.tell(0.15 + (0.85 * points.length) / FRAMES, `${points.length} of ${FRAMES} frames, ${made.renderer}, ${made.timed}`);
        if (points.length === FIRST_FIT) await fit();
      }
      if (points.length > sent) this.show(await fit(), stop.signal.aborted);
    } catch (error) {
      const { text, advice } = explain(error);
      this.result.replaceChildren(note("bad", "fail", "Not measured", sentences(text, advice || "Try again, or another browser.")));
    } finally {
      bench?.dispose();
      this.picture.replaceChildren();
      this.stop = null;
      this.button.textContent = "Measure this device";
      this.status.textContent = `${points.length} frames in ${Math.round((Date.now() - began) / 1000)} s.`;
      this.changed();
    }
  }

  private tell(share: number, text: string): void {
    (this.bar.firstElementChild as HTMLElement).style.setProperty("--at", `${(100 * share).toFixed(1)}%`);
    this.bar.setAttribute("aria-valuenow", String(Math.round(100 * share)));
    this.status.textContent = text;
  }

  private show(device: Device, stopped: boolean): void {
    if (device.missing || !device.profile) {
      const way = stopped ? "You stopped early: measure again under the same name, and it goes on." : "Measure again under the same name: frames add up.";
      this.result.replaceChildren(note("inf", "infeas", "No profile yet", sentences(device.missing?.detail ?? "There are too few frames", device.missing?.advice, way)));
      return;
    }
    this.result.replaceChildren(note("ok", "done", `${device.name} is measured`, h("span", null, `A job names it as its device. `, h("a", { href: "/jobs" }, "To the jobs"), ".")));
  }
}

/** What the browser says of the graphics card, as far as it is a name; else of the system. */
function suggestedName(): string {
  const found = /Windows|Mac OS X|Android|iPhone|iPad|Linux|CrOS/.exec(navigator.userAgent)?.[0] ?? "device";
  return `my ${found.replace(" OS X", "").replace("CrOS", "Chromebook")}`.slice(0, NAME_MOST);
}
