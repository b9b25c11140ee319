/** `manifest.json`: what docs/formats/placementdb.md section 2 says, checked. */
import { ColumnsAltered, ColumnsTooNew, ColumnsTruncated, NotColumns } from "./errors";
import { sha256 } from "./sha256";

export const MANIFEST_VERSION = 6; // index and chunks squeezed, the level in pages
export const DETAIL_VERSION = 4; // with levels of detail; 5: with pages other than WebP, with levels or without
export const PLAIN_VERSION = 3; // without levels of detail. Older ones are refused: their alpha held no coverage

export type Vec3 = [number, number, number];
export type Box = [Vec3, Vec3];
export interface FileEntry {
  file: string;
  bytes: number;
  sha256: string;
  expanded?: number; // bytes when inflated: of squeezed files
}
/** The level in pages; `memory` is what a page takes in video memory. */
export interface GeometryEntry {
  index: FileEntry;
  pages: (FileEntry & { memory: number })[];
  textures: (FileEntry & { width: number; height: number })[];
  notice?: string;
}
export interface ChunkEntry extends FileEntry {
  node: number;
  cells: [number, number];
  views: [number, number];
  box: Box;
  pages: number[];
}
export interface PageEntry extends FileEntry {
  impostors: number;
}
export interface PageLevel {
  x: number;
  y: number;
  size: number;
}
export type PageFormat = "webp" | "png" | "ktx2"; // left out: webp
export type CostUnit = "ns" | "calls" | "triangles";
export interface CostModel {
  per_frame: number;
  target: number;
  per_call: number;
  per_triangle: number;
  per_pixel: number;
  per_impostor: number;
  per_impostor_triangle: number;
  per_impostor_pixel: number;
}
export interface Manifest {
  format: string;
  version: number;
  origin_m: Vec3;
  view_space: Box[];
  camera: { fov_deg: number; width: number; height: number };
  quality: { pixel_error: number; pixels_at: string };
  budget: { text: string; unit: CostUnit; amount: number };
  cost_model: CostModel;
  interval_edges: number[];
  counts: Record<
    "objects" | "triangles" | "clusters" | "nodes" | "cells" | "problem_views" | "hopeless_views" | "impostors" | "layers" | "chunks" | "pages",
    number
  >;
  bounds: Box | null;
  bytes: number;
  video_bytes: number;
  file_bytes: number;
  worst_nonproblem: number;
  visibility: string;
  lighting: Record<string, unknown> | null;
  verdict: "valid" | "infeasible" | "unproven";
  page: { size: number; width: number; height: number; levels: PageLevel[]; format?: PageFormat };
  index: FileEntry;
  chunks: ChunkEntry[];
  pages: PageEntry[];
  geometry?: GeometryEntry | null; // null: the level is in scene.glb only
  scene: { file: string; sha256: string; notice?: string } | null;
  provenance: { settings?: Record<string, unknown>; software?: Record<string, unknown>; inputs?: Record<string, unknown> };
  notice?: string;
}

const SEAL = '"manifest_sha256":"';

/** Parses and checks; throws NotColumns, ColumnsTooNew, ColumnsTruncated, ColumnsAltered. */
export async function readManifest(bytes: Uint8Array, where: string): Promise<Manifest> {
  const text = new TextDecoder("latin1").decode(bytes);
  let parsed: unknown;
  try {
    parsed = JSON.parse(text);
  } catch {
    if (text.startsWith("{") && !text.endsWith("}\n")) throw new ColumnsTruncated(where, bytes.length, bytes.length + 1);
    throw new ColumnsAltered(where, "it is not JSON");
  }
  const m = parsed as Manifest;
  if (m === null || typeof m !== "object" || m.format !== "farfield placement") throw new NotColumns(where);
  if (typeof m.version !== "number") throw new ColumnsAltered(where, "it states no version");
  if (m.version < PLAIN_VERSION || m.version > MANIFEST_VERSION) throw new ColumnsTooNew(where, m.version, MANIFEST_VERSION);
  await checkSeal(text, bytes, where);
  const fault = findFault(m);
  if (fault) throw new ColumnsAltered(where, fault);
  return m;
}

async function checkSeal(text: string, bytes: Uint8Array, where: string): Promise<void> {
  const at = text.indexOf(SEAL) + SEAL.length;
  const stated = text.slice(at, at + 64);
  if (at < SEAL.length || text.indexOf(SEAL, at) >= 0 || !/^[0-9a-f]{64}$/.test(stated)) {
    throw new ColumnsAltered(where, "it states no digest of itself");
  }
  const blank = bytes.slice();
  blank.fill(0x30, at, at + 64);
  if ((await sha256(blank)) !== stated) throw new ColumnsAltered(where, "its SHA-256 is not the one stated");
}

function findFault(m: Manifest): string | null {
  const numbers = (a: unknown, n: number): boolean => Array.isArray(a) && a.length === n && a.every((x) => typeof x === "number");
  const box = (b: unknown): boolean => Array.isArray(b) && b.length === 2 && numbers(b[0], 3) && numbers(b[1], 3);
  const count = (n: unknown): boolean => typeof n === "number" && Number.isSafeInteger(n) && n >= 0;
  const file = (f: FileEntry): boolean =>
    typeof f?.file === "string" && /^[\w.-]+(\/[\w.-]+)*$/.test(f.file) && !f.file.includes("..") && count(f.bytes) && (!f.file.endsWith(".ffz") || count(f.expanded)) && /^[0-9a-f]{64}$/.test(f.sha256);
  const edges = m.interval_edges;
  if (!numbers(m.origin_m, 3)) return "origin_m is not a point";
  if (!Array.isArray(m.view_space) || !m.view_space.length || !m.view_space.every(box)) return "view_space is not a list of boxes";
  if (!(m.camera?.fov_deg > 0 && m.camera.fov_deg < 180 && m.camera.width > 0 && m.camera.height > 0)) return "camera is not readable";
  if (!["ns", "calls", "triangles"].includes(m.budget?.unit) || !count(m.budget.amount)) return "budget is not readable";
  if (!m.cost_model || !count(m.cost_model.per_frame)) return "cost_model is not readable";
  if (!Array.isArray(edges) || edges.length < 2 || edges[0] !== -1 || edges.at(-1) !== 1) return "interval_edges are not readable";
  if (edges.some((e, i) => i > 0 && !(e > edges[i - 1]))) return "interval_edges do not rise";
  if (!m.counts || !Object.values(m.counts).every(count)) return "counts are not readable";
  if (m.bounds !== null && !box(m.bounds)) return "bounds are not a box";
  if (!file(m.index)) return "index is not readable";
  if (!Array.isArray(m.pages) || !m.pages.every(file)) return "pages are not readable";
  const chunk = (c: ChunkEntry): boolean =>
    file(c) && numbers(c.cells, 2) && numbers(c.views, 2) && box(c.box) && Array.isArray(c.pages) && c.pages.every((p) => count(p) && p < m.pages.length);
  if (!Array.isArray(m.chunks) || !m.chunks.every(chunk)) return "chunks are not readable";
  if (m.chunks.some((c, i) => i > 0 && c.cells[0] < m.chunks[i - 1].cells[1])) return "chunks overlap";
  if (m.counts.pages !== m.pages.length || m.counts.chunks !== m.chunks.length) return "counts are not those of its lists";
  if (!m.page || !Array.isArray(m.page.levels) || !m.page.levels.every((l) => count(l.x) && count(l.y) && count(l.size))) return "page is not readable";
  const g = m.geometry;
  const listed = (a: unknown, fits: (f: any) => boolean): boolean => Array.isArray(a) && a.every((f) => file(f) && fits(f));
  if (g && !(file(g.index) && listed(g.pages, (f) => count(f.memory)) && listed(g.textures, (f) => f.width > 0 && f.height > 0))) {
    return "geometry is not readable";
  }
  const format = m.page.format ?? "webp";
  if (!["webp", "png", "ktx2"].includes(format) || !m.pages.every((p) => p.file.endsWith(`.${format}`))) return "pages are not of the stated format";
  return null;
}
