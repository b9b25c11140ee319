/**
 * Draws one way along one walk and tells the command that opened the page: for `farfield experiment compare`.
 *
 * Method  A pass that fetches whatever the walk needs and is not timed, then timed passes; a frame's time is the least of them, until its
 *         last pixel can be read back. Nothing is fetched while a frame is timed. At some frames the picture is kept: geometry's are what
 *         the others are held against.
 */
import { flip } from "../error/flip";
import { makeContext } from "../gl/context";
import { Placement } from "../placementdb/placement";
import { fetchFile, fetchFrom, makeTraffic } from "../stream/files";
import { Engine } from "../viewer/engine";
import type { Vec3 } from "../placementdb/manifest";
import { batchedWay } from "./batched";
import { Counted } from "./counted";
import { engineWay } from "./engine_way";
import { Frame } from "./frame";
import { octahedralWay } from "./octahedral";
import { simplifiedWay } from "./simplified";
import type { Given, Way } from "./way";
import { loadWhole, type Whole } from "./whole";

interface Task {
  way: keyof typeof WAYS;
  reference: boolean; // its pictures are what others are held against
  walk: number[][]; // rows of position and direction
  pictures: number[]; // rows that are compared
  passes: number;
}

const WAYS = { engine: engineWay, batched: batchedWay, simplified: simplifiedWay, octahedral: octahedralWay };

const tell = (path: string, body: string | Uint8Array): Promise<Response> =>
  fetch(`/compare/${path}`, { method: "POST", body: body as BodyInit });

async function run(): Promise<object> {
  const task = (await (await fetch("/compare/task")).json()) as Task;
  const traffic = makeTraffic();
  const base = "/compare/files/";
  const placement = await Placement.open(fetchFrom(base, traffic));
  const { width, height } = placement.manifest.camera;
  const canvas = document.getElementById("picture") as HTMLCanvasElement;
  canvas.width = width;
  canvas.height = height;
  const gl = makeContext(canvas);
  const counted = new Counted(gl);
  const engine = new Engine(canvas, gl, placement);
  let began = performance.now();
  const whole = async (): Promise<Whole> => {
    const glb = (await fetchFile(`${base}scene.glb`, traffic))!;
    const level = await loadWhole(engine, placement, glb.buffer as ArrayBuffer);
    began = performance.now(); // loading the level is no preprocessing: every way does it
    return level;
  };
  const given: Given = { engine, placement, frame: new Frame(gl, placement), whole };
  const way: Way = await WAYS[task.way](given);
  pixel(gl);
  const preparedSeconds = (performance.now() - began) / 1000;

  const views = task.walk.map((row) => [row.slice(0, 3), row.slice(3)] as [Vec3, Vec3]);
  const frames = views.map(() => ({ ms: Infinity, calls: 0, parts: 0, triangles: 0 }));
  const wrong: string[] = [];
  let fetched = 0;
  let bytes = 0;
  for (let pass = 0; pass <= task.passes; pass++) {
    for (const [k, [position, direction]] of views.entries()) {
      if ((await way.settle(position, direction)) && pass) fetched++;
      counted.reset();
      const start = performance.now();
      way.draw(position, direction);
      pixel(gl);
      const ms = performance.now() - start;
      bytes = Math.max(bytes, counted.bytes);
      if (!pass) continue;
      const { calls, parts, triangles } = counted;
      const { claimed } = way;
      // One call shows the averaged picture.
      if (claimed && (claimed.calls !== calls - 1 || claimed.triangles !== triangles - 1)) {
        wrong.push(`frame ${k}: ${claimed.calls} calls and ${claimed.triangles} triangles claimed, ${calls - 1} and ${triangles - 1} drawn`);
      }
      frames[k] = { ms: Math.min(frames[k].ms, ms), calls: calls - 1, parts: parts - 1, triangles: triangles - 1 };
      await new Promise((resolve) => setTimeout(resolve));
    }
  }
  const pictures: { frame: number; flip: number | null }[] = [];
  for (const k of task.pictures) {
    await way.settle(...views[k]);
    way.draw(...views[k]);
    const shown = picture(gl);
    if (task.reference) await tell(`picture/${k}`, shown);
    const kept = await fetch(`/compare/picture/${k}`);
    const truth = kept.ok ? new Uint8Array(await kept.arrayBuffer()) : null; // null: geometry was not drawn
    if (task.reference) way.draw(...views[k]); // against itself: drawn once more
    pictures.push({ frame: k, flip: truth && flip(truth, task.reference ? picture(gl) : shown, width, height).mean });
  }
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  return {
    frames, pictures, wrong: wrong.slice(0, 5), fetched, bytes, said: way.said, prepared_seconds: preparedSeconds, prepared_bytes: way.preparedBytes,
    unknown_formats: [...counted.unknown], renderer: info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "not told",
    browser: navigator.userAgent,
  };
}

/** Waits for the GPU: what is read back is drawn. */
function pixel(gl: WebGL2RenderingContext): void {
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
}

function picture(gl: WebGL2RenderingContext): Uint8Array {
  const { width, height } = gl.canvas;
  const out = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
  return out;
}

const said = document.getElementById("said")!;
window.addEventListener("error", (e) => void tell("result", JSON.stringify({ error: e.message })));
run()
  .catch((error: unknown) => ({ error: error instanceof Error ? `${error.message}\n${error.stack}` : String(error) }))
  .then(async (result) => {
    said.textContent = "error" in result ? String(result.error) : "Done.";
    await tell("result", JSON.stringify(result));
  })
  .catch((error: unknown) => (said.textContent = String(error)));
