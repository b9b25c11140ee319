/** Opens /viewer/{id}: placement, then geometry, then the frame loop; says what went wrong and what to do. */
import "../style/tokens.css";
import "../style/base.css";
import "../style/viewer.css";
import { makeContext, NoWebGl2 } from "../gl/context";
import { ColumnsAltered, PlacementFileError, PlacementFileMissing } from "../placementdb/errors";
import { Placement, type FetchBytes } from "../placementdb/placement";
import { sha256 } from "../placementdb/sha256";
import { capsOf } from "../stream/caps";
import { AccessDenied, fetchFile, fetchFrom, makeTraffic, type Traffic } from "../stream/files";
import { KeptFiles } from "../stream/kept";
import { byId, setShown, setText } from "../ui/dom";
import { bytes } from "../ui/format";
import { applyTheme } from "../ui/theme";
import { App } from "./app";
import { Engine } from "./engine";
import { makeHook, type Hook } from "./hook";
import { failure } from "./overlay";

declare global {
  interface Window {
    farfield: Hook;
  }
}

const RESTORED = "farfield restored after a reset";

applyTheme();
const started = start();
window.farfield = makeHook(started);
started.catch(explain);

async function start(): Promise<App> {
  const canvas = byId<HTMLCanvasElement>("picture");
  const gl = makeContext(canvas);
  canvas.addEventListener("webglcontextlost", (e) => {
    e.preventDefault();
    failure("The graphics driver has reset", "What was in video memory is lost. The viewer comes back as soon as the driver does.");
  });
  // All that video memory held comes anew, from the cache: the address holds the view.
  canvas.addEventListener("webglcontextrestored", () => {
    const before = Number(sessionStorage.getItem(RESTORED));
    if (before && Date.now() - before < 30_000) return failure("The graphics driver resets again and again", "Close other pages that draw, then load this one again.");
    sessionStorage.setItem(RESTORED, String(Date.now()));
    void started.then((app) => history.replaceState(null, "", app.shared())).finally(() => location.reload());
  });
  const id = location.pathname.split("/").filter(Boolean).at(-1) ?? "";
  const base = `/v1/placements/${encodeURIComponent(decodeURIComponent(id))}/`;
  const traffic = makeTraffic();
  progress("Loading placement", "manifest and index", 0);
  const files = fetchFrom(base, traffic, await KeptFiles.open(base));
  const placement = await Placement.open(files);
  const memory = new URLSearchParams(location.search).get("memory");
  const engine = new Engine(canvas, gl, placement, capsOf(placement.manifest, memory === null ? null : Number(memory)));
  if (placement.manifest.geometry) await engine.openLevel();
  const app = new App(engine, placement, traffic, canvas, decodeURIComponent(id));
  app.follow(location.hash);
  window.addEventListener("hashchange", () => app.follow(location.hash));
  if (!placement.manifest.geometry) await loadGeometry(base, traffic, placement, engine);
  setShown("loading", false);
  app.touch();
  void app.begun.then(() => bookmark(files, app)).then(keepViewer);
  credit(engine.level.notice || placement.manifest.scene?.notice || placement.manifest.notice || "", id);
  return app;
}

/** Bookmarks from the report, where there is one that can be read: the viewer needs none. */
async function bookmark(files: FetchBytes, app: App): Promise<void> {
  try {
    const report = await files("report.json");
    if (report) app.offerWorstViews(JSON.parse(new TextDecoder().decode(report)));
  } catch (error) {
    console.warn("no bookmarks: the report cannot be read", error);
  }
}

/** Has this page, and what it is made of, kept for when the service cannot be reached (public/offline.js). */
async function keepViewer(): Promise<void> {
  try {
    await navigator.serviceWorker?.register("/offline.js", { scope: "/viewer/" });
    const { active } = (await navigator.serviceWorker?.ready) ?? {};
    active?.postMessage([location.href, ...performance.getEntriesByType("resource").map((entry) => entry.name)]);
  } catch (error) {
    console.info("this page will not open without the service", error);
  }
}

async function loadGeometry(base: string, traffic: Traffic, placement: Placement, engine: Engine): Promise<void> {
  const name = "scene.glb";
  const glb = await fetchFile(base + name, traffic, undefined, (got, total) =>
    progress("Loading geometry", `${bytes(got)} of ${bytes(total)}`, got / total),
  );
  if (!glb) throw new PlacementFileMissing(name);
  const stated = placement.manifest.scene?.sha256;
  if (stated && (await sha256(glb)) !== stated) throw new ColumnsAltered(name, "its SHA-256 is not the one in the manifest");
  progress("Preparing geometry", `${placement.manifest.counts.objects} objects`, 1);
  await new Promise((resolve) => setTimeout(resolve));
  await engine.level.load(glb.buffer as ArrayBuffer, placement.manifest.counts.objects, placement.index.levelRow);
}

function progress(title: string, text: string, share: number): void {
  setShown("loading", true);
  setText("loading-title", title);
  setText("loading-text", text);
  (byId("loading-bar").firstElementChild as HTMLElement).style.width = `${100 * share}%`;
}

/** The data notice of the level, and the way to the report. */
function credit(text: string, id: string): void {
  const line = byId("attribution");
  const link = document.createElement("a");
  link.href = `/viewer/${encodeURIComponent(id)}/report`;
  link.textContent = "Report";
  line.replaceChildren(text ? `${text} · ` : "", link);
}

function explain(error: unknown): void {
  setShown("loading", false);
  if (error instanceof NoWebGl2) {
    failure("No WebGL 2", `${error.message} Another browser, or its setting for hardware acceleration, may help.`);
  } else if (error instanceof AccessDenied) {
    failure("Not signed in", error.message);
  } else if (error instanceof PlacementFileError) {
    const missing = error instanceof PlacementFileMissing && error.where === "manifest.json";
    failure(missing ? "No placement here" : "Placement damaged", `${error.message} ${error.advice}`);
  } else {
    failure("The viewer cannot start", error instanceof Error ? error.message : String(error));
  }
  for (const element of document.querySelectorAll<HTMLElement>(".overlay, .h-bar")) element.hidden = true;
}
