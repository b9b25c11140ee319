/** The panel of a new job: a level dropped or chosen, sent, looked at, its settings settled, started. */
import { createJob, explain, findScene, readJob, Refused } from "../api/client";
import type { Settings } from "../api/schema";
import type { Scene } from "../api/types";
import { uploadScene, type UploadStep } from "../api/upload";
import { bytes, count } from "../ui/format";
import { h } from "./element";
import { duration, metres, plural, sentences } from "./format";
import { note, onKey } from "./frame";
import { progressBar } from "./job_row";
import { icon, stateMark } from "./icons";
import { planCaption } from "./scene_plan";
import { readPlan } from "./read_plan";
import { SettingsForm } from "./settings_form";

const FORMATS = ".glb,.gltf,.obj,.ply,.stl,.zip";
const SHOWN_WARNINGS = 8;

export class NewJob {
  readonly element: HTMLElement;
  private readonly input = h("input", { type: "file", class: "sr", accept: FORMATS });
  private readonly up = h("div", { class: "up", "aria-live": "polite", hidden: true });
  private readonly preview = h("div");
  private abort: AbortController | null = null;

  constructor(canSubmit: boolean, private readonly created: (page: string) => void) {
    const drop = h("label", { class: "drop" }, h("strong", null, "Drop a level here"), "or choose a file", h("br"),
      h("span", { class: "small" }, "GLB, glTF, OBJ, PLY, STL, or a zip with all its files"), this.input);
    this.element = h("aside", { class: "panel", id: "new", "aria-labelledby": "nj" }, h("header", null, h("h2", { id: "nj" }, "New job")));
    if (!canSubmit) {
      this.element.append(h("p", { class: "q2" }, "Your key can read jobs but not start them: it lacks the scope submit."));
      return;
    }
    this.element.append(drop, this.up, this.preview);
    this.input.addEventListener("change", () => this.take(this.input.files));
    onKey("n", () => this.input.focus());
    let depth = 0;
    const files = (e: DragEvent): boolean => e.dataTransfer?.types.includes("Files") ?? false;
    addEventListener("dragenter", (e) => files(e) && document.body.classList.toggle("dropping", ++depth > 0));
    addEventListener("dragleave", (e) => files(e) && document.body.classList.toggle("dropping", --depth > 0));
    addEventListener("dragover", (e) => files(e) && e.preventDefault());
    addEventListener("drop", (e) => {
      if (!files(e)) return;
      e.preventDefault();
      depth = 0;
      document.body.classList.remove("dropping");
      this.take(e.dataTransfer!.files);
    });
    addEventListener("hashchange", () => void this.readAddress());
    void this.readAddress();
  }

  /** /jobs#again=JOB&budget=18+ms: the settings of that job, to be started anew. */
  private async readAddress(): Promise<void> {
    const given = new URLSearchParams(location.hash.slice(1));
    const again = given.get("again");
    if (!again) return;
    history.replaceState(null, "", location.pathname);
    try {
      const job = await readJob(again);
      const scene = await findScene(job.scene);
      const budget = given.get("budget");
      if (scene) this.show(scene, budget ? { ...job.settings, budget } : job.settings);
    } catch (error) {
      this.refused("The job cannot be read", error);
    }
  }

  private take(files: FileList | null): void {
    if (!files?.length) return;
    if (files.length > 1) {
      this.preview.replaceChildren(note("inf", "infeas", "One file at a time", "A level of several files goes into one zip, with relative names."));
      return;
    }
    void this.send(files[0]);
    this.input.value = "";
  }

  private async send(file: File): Promise<void> {
    this.abort?.abort(new DOMException("another file was chosen", "AbortError"));
    const abort = (this.abort = new AbortController());
    this.preview.replaceChildren();
    this.up.hidden = false;
    let announced = "";
    try {
      const scene = await uploadScene(file, (step) => {
        if (this.abort === abort) announced = this.progress(file, step, announced, abort);
      }, abort.signal);
      if (this.abort === abort) this.show(scene, {});
    } catch (error) {
      if (this.abort !== abort) return;
      this.up.hidden = true;
      if (abort.signal.aborted) return;
      this.refused(file.name, error);
    }
  }

  private progress(file: File, step: UploadStep, before: string, abort: AbortController): string {
    const words = { hashing: "reading it here", sending: "sending", reading: "the service reads it", known: "known already" };
    const part = "bytes" in step ? step.bytes / Math.max(step.total, 1) : 1;
    const rate = step.step === "sending" && step.bytesPerSecond ? `${bytes(step.bytesPerSecond)}/s · ${duration((step.total - step.bytes) / step.bytesPerSecond)}` : "";
    const size = "bytes" in step ? `${bytes(step.bytes)} of ${bytes(step.total)}` : bytes(file.size);
    const stop = step.step === "known" ? null : h("button", { class: "btn plain act", type: "button", onclick: () => abort.abort(new DOMException("stopped", "AbortError")) }, "Stop");
    if (before === step.step && this.up.childElementCount === 3) {
      // Only the figures move: the rest keeps focus, and a screen reader hears each step once.
      (this.up.querySelector(".bar i") as HTMLElement).style.setProperty("--at", `${100 * part}%`);
      this.up.querySelector(".bar")!.setAttribute("aria-valuenow", String(Math.round(100 * part)));
      this.up.querySelector("[data-size]")!.textContent = size;
      this.up.querySelector("[data-rate]")!.textContent = rate;
      return step.step;
    }
    const waits = step.step === "reading";
    this.up.replaceChildren(
      h("div", null, h("b", { title: file.name }, file.name), stateMark(step.step === "known" ? "ok" : "run", step.step === "known" ? "done" : "run", words[step.step])),
      progressBar(waits ? "wait" : "", waits ? 0 : part, [], file.name),
      h("div", { class: "q" }, h("span", { "data-size": "", "aria-hidden": "true" }, size), h("span", null, h("span", { "data-rate": "", "aria-hidden": "true" }, rate), " ", stop)));
    return step.step;
  }

  private refused(name: string, error: unknown): void {
    const { text, advice } = explain(error);
    const title = error instanceof Refused ? `${name}: ${error.code}` : name;
    const again = h("button", { type: "button", onclick: () => this.input.click() }, "Choose another file");
    this.preview.replaceChildren(h("div", { role: "alert" }, note("bad", "fail", title, sentences(text, "Nothing was stored.", advice), again)));
  }

  private show(scene: Scene, base: Settings): void {
    this.up.hidden = true;
    const form = new SettingsForm(scene, base);
    const says = h("div", { class: "wide", role: "alert" });
    const start = h("button", { class: "btn primary" }, "Start job");
    const key = crypto.randomUUID?.() ?? String(Math.random());
    let attempt = 0;
    const box = h("form", { class: "set", "aria-label": "Settings", onsubmit: (e: Event) => (e.preventDefault(), void submit()) },
      ...form.fields, ...viewSpaceLine(scene, base), says, h("div", { class: "go" }, start, h("button", { type: "button", onclick: () => this.clear() }, "Discard")));
    const submit = async (): Promise<void> => {
      const settings = form.read();
      if (!settings) return;
      start.disabled = true;
      try {
        // A refused request has made nothing; changed settings need a key of their own.
        const job = await createJob({ scene: scene.digest, settings, name: scene.name, priority: form.priority }, `${key}-${attempt}`);
        this.created(job.links.page);
      } catch (error) {
        if (error instanceof Refused) attempt++;
        start.disabled = false;
        const { text, advice } = explain(error);
        if (!(error instanceof Refused && error.key && form.mark(error.key, text))) says.replaceChildren(note("bad", "fail", "Not started", sentences(text, advice)));
      }
    };
    const plan = h("div");
    this.preview.replaceChildren(h("h3", null, scene.name), plan, facts(scene), warnings(scene), box);
    void drawPlan(scene, plan);
    this.element.scrollIntoView({ block: "nearest" });
    (box.querySelector("input") as HTMLElement).focus({ preventScroll: true });
  }

  private clear(): void {
    this.preview.replaceChildren();
    this.input.focus();
  }
}

function viewSpaceLine(scene: Scene, base: Settings): HTMLElement[] {
  const boxes = base.view_space?.boxes ?? scene.suggested?.view_space.boxes;
  if (!boxes?.length) return [];
  const size = [0, 2].map((a) => Math.max(...boxes.map((b) => b[1][a])) - Math.min(...boxes.map((b) => b[0][a])));
  const why = base.view_space?.boxes ? "as in the earlier job" : scene.suggested?.why["view_space.boxes"];
  return [h("div", { class: "lab" }, "View space", h("small", null, why ?? "")), h("div", { class: "r" }, plural(boxes.length, "box", "boxes"), h("br"), h("small", { class: "q" }, `${metres(size[0])} × ${metres(size[1])} m`))];
}

async function drawPlan(scene: Scene, where: HTMLElement): Promise<void> {
  if (!scene.bounds || !scene.suggested) return;
  const boxes = scene.suggested.view_space.boxes;
  const hold = h("div", { class: "plan-box" }); // of the plan's size, so that nothing below jumps
  where.replaceChildren(hold, h("p", { class: "small q2" }, `from above; ${planCaption(boxes)}`));
  hold.append(await readPlan(scene, scene.bounds, boxes));
}

function facts(scene: Scene): HTMLElement {
  const rows: [string, string][] = [["Objects", `${count(scene.objects)}${scene.meshes ? ` from ${plural(scene.meshes, "mesh", "meshes")}` : ""}`], ["Triangles", count(scene.triangles)]];
  if (scene.calls !== undefined) rows.push(["Draw calls", count(scene.calls)]);
  if (scene.bounds) {
    const [a, b] = scene.bounds;
    rows.push(["Bounds", `${[0, 1, 2].map((k) => metres(b[k] - a[k])).join(" × ")} m`]);
  }
  if (scene.materials !== undefined) rows.push(["Materials", `${count(scene.materials)}${scene.textures ? `, ${plural(scene.textures, "texture")}` : ""}`]);
  rows.push(["File", bytes(scene.bytes)]);
  const work = scene.suggested?.work;
  if (work) rows.push(["Work as suggested", `${count(work.cells)} cells × ${count(work.directions)} directions, about ${duration(work.seconds)}`]);
  return h("dl", { class: "kv" }, ...rows.flatMap(([k, v]) => [h("dt", null, k), h("dd", null, v)]));
}

function warnings(scene: Scene): HTMLElement {
  const shown = scene.warnings.slice(0, SHOWN_WARNINGS).map((w) => h("li", { class: "over" }, icon("infeas"), h("span", null, w)));
  const rest = scene.warnings.length - shown.length;
  if (rest > 0) shown.push(h("li", { class: "q2" }, icon("note"), h("span", null, `and ${plural(rest, "more warning")}`)));
  if (scene.dropped_triangles) shown.push(h("li", { class: "q2" }, icon("note"), h("span", null, `${plural(scene.dropped_triangles, "triangle")} without area ignored`)));
  return h("ul", { class: "warn" }, ...shown);
}
