/**
 * The placement database as a whole: manifest, index, and chunks as they come. No DOM, no WebGL.
 *
 * `fetchBytes` is how files arrive (network, disk); each is checked against the manifest's size and SHA-256.
 */
import { findCell } from "../select/cells";
import { findInterval } from "../select/intervals";
import { setLevels } from "../select/levels";
import { readChunk, type PlacementChunk } from "./chunk";
import type { Container } from "./columns";
import { ColumnsAltered, ColumnsTruncated, DirectionInvalid, OutsideViewSpace, PlacementFileMissing } from "./errors";
import { readGeometryIndex, readGeometryPage, type GeometryIndex, type GeometryPage } from "./geometry";
import { readIndex, type PlacementIndex } from "./index_file";
import { readManifest, type FileEntry, type Manifest } from "./manifest";
import { sha256 } from "./sha256";
import { unpackFile } from "./squeeze";

/** Resolves to null where the file does not exist; `name` is relative to the placement; `anew`: past every cache. */
export type FetchBytes = (name: string, signal?: AbortSignal, anew?: boolean) => Promise<Uint8Array | null>;

/** What one position and direction show; `objects` is null where every object is visible and none is covered. */
export interface Lookup {
  cell: number;
  interval: number;
  problemView: number | null;
  hopeless: boolean;
  impostors: number[];
  objects: number[];
  levels: number[]; // of each of the objects: 0 itself, else a coarser level
  costBound: number;
}

export class Placement {
  readonly manifest: Manifest;
  readonly index: PlacementIndex;
  private readonly fetchBytes: FetchBytes;
  private readonly loaded = new Map<number, PlacementChunk>();

  private constructor(manifest: Manifest, index: PlacementIndex, fetchBytes: FetchBytes) {
    this.manifest = manifest;
    this.index = index;
    this.fetchBytes = fetchBytes;
  }

  static async open(fetchBytes: FetchBytes): Promise<Placement> {
    const bytes = await fetchBytes("manifest.json");
    if (!bytes) throw new PlacementFileMissing("manifest.json");
    const manifest = await readManifest(bytes, "manifest.json");
    return new Placement(manifest, readIndex(await fetchContainer(fetchBytes, manifest.index), manifest.index.file, manifest), fetchBytes);
  }

  /** Bytes of a page file (WebP), checked. */
  page(id: number, signal?: AbortSignal): Promise<Uint8Array> {
    return fetchChecked(this.fetchBytes, this.manifest.pages[id], signal);
  }

  /** The chunk, fetched when it is not there yet. */
  async chunk(number: number, signal?: AbortSignal): Promise<PlacementChunk> {
    const known = this.loaded.get(number);
    if (known) return known;
    const entry = this.manifest.chunks[number];
    const chunk = readChunk(await fetchContainer(this.fetchBytes, entry, signal), entry.file, this.manifest, number);
    this.loaded.set(number, chunk);
    return chunk;
  }

  residentChunk(number: number): PlacementChunk | undefined {
    return this.loaded.get(number);
  }

  dropChunk(number: number): void {
    this.loaded.delete(number);
  }

  /** Which mesh each object shows, and materials; only where the manifest has `geometry`. */
  async geometry(): Promise<GeometryIndex> {
    const entry = this.manifest.geometry!.index;
    return readGeometryIndex(await fetchContainer(this.fetchBytes, entry), entry.file, this.manifest, this.index);
  }

  async geometryPage(number: number, signal?: AbortSignal): Promise<GeometryPage> {
    const entry = this.manifest.geometry!.pages[number];
    return readGeometryPage(await fetchContainer(this.fetchBytes, entry, signal), entry.file, number);
  }

  /** Bytes of an image file, checked. */
  texture(file: number, signal?: AbortSignal): Promise<Uint8Array> {
    return fetchChecked(this.fetchBytes, this.manifest.geometry!.textures[file], signal);
  }

  /** Checks every file against its size, digest and structure. */
  async check(): Promise<void> {
    for (let k = 0; k < this.manifest.chunks.length; k++) await this.chunk(k);
    for (let p = 0; p < this.manifest.pages.length; p++) await this.page(p);
    if (!this.manifest.geometry) return;
    await this.geometry();
    for (let p = 0; p < this.manifest.geometry.pages.length; p++) await this.geometryPage(p);
    for (let x = 0; x < this.manifest.geometry.textures.length; x++) await this.texture(x);
  }

  /** Format section 6, all steps; fetches the chunk where needed. `OutsideViewSpace`, `DirectionInvalid`. */
  async lookup(position: ArrayLike<number>, direction: ArrayLike<number>): Promise<Lookup> {
    const cell = findCell(this.index, this.manifest, position);
    if (cell < 0) throw new OutsideViewSpace(position);
    const interval = findInterval(this.manifest.interval_edges, direction);
    if (interval < 0) throw new DirectionInvalid(direction);
    const number = chunkOfCell(this.manifest, cell);
    return describe(this, cell, interval, number < 0 ? null : await this.chunk(number));
  }
}

/** Position in the manifest's list of the chunk that holds the cell, -1 if none does. */
export function chunkOfCell(manifest: Manifest, cell: number): number {
  let low = 0;
  let high = manifest.chunks.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (manifest.chunks[middle].cells[1] <= cell) low = middle + 1;
    else high = middle;
  }
  return low < manifest.chunks.length && manifest.chunks[low].cells[0] <= cell ? low : -1;
}

/** Local problem view of a cell and interval in its chunk, -1 if that pair is none. */
export function viewInChunk(chunk: PlacementChunk, cell: number, interval: number): number {
  const c = cell - chunk.cells[0];
  let low = chunk.cellView[c];
  let high = chunk.cellView[c + 1];
  const end = high;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (chunk.viewInterval[middle] < interval) low = middle + 1;
    else high = middle;
  }
  return low < end && chunk.viewInterval[low] === interval ? low : -1;
}

/** The visible objects of a cell, ascending; null: all of them. */
export function visibleOfCell(chunk: PlacementChunk | null, cell: number): Int32Array | null {
  if (!chunk || !chunk.cellVisible.length) return null;
  const list = chunk.cellVisible[cell - chunk.cells[0]];
  return chunk.visibleObject.subarray(chunk.visibleRow[list], chunk.visibleRow[list + 1]);
}

/** Local impostors of a local problem view, ascending. */
export function impostorsOfView(chunk: PlacementChunk, view: number): Int32Array {
  const list = chunk.viewList[view];
  return chunk.listImpostor.subarray(chunk.listRow[list], chunk.listRow[list + 1]);
}

export interface Served {
  views: number; // problem views whose list holds the impostor, in the chunks that are here
  all: boolean; // every chunk is here
}

export function viewsServed(p: Placement, impostor: number): Served {
  const served: Served = { views: 0, all: true };
  for (let number = 0; number < p.manifest.chunks.length; number++) {
    const chunk = p.residentChunk(number);
    if (!chunk) {
      served.all = false;
      continue;
    }
    const local = chunk.impostorId.indexOf(impostor);
    if (local < 0) continue;
    for (let view = 0; view < chunk.viewList.length; view++) if (impostorsOfView(chunk, view).includes(local)) served.views++;
  }
  return served;
}

function describe(p: Placement, cell: number, interval: number, chunk: PlacementChunk | null): Lookup {
  const { manifest, index } = p;
  const view = chunk ? viewInChunk(chunk, cell, interval) : -1;
  const impostors = chunk && view >= 0 ? Array.from(impostorsOfView(chunk, view), (m) => chunk.impostorId[m]) : [];
  const covered = new Uint8Array(manifest.counts.objects);
  for (const id of impostors) {
    const cluster = index.impostorCluster[id];
    covered.fill(1, index.clusterStart[cluster], index.clusterStop[cluster]);
  }
  const visible = visibleOfCell(chunk, cell) ?? Int32Array.from(covered.keys());
  const objects = Array.from(visible).filter((o) => !covered[o]);
  const levels = new Uint8Array(manifest.counts.objects);
  setLevels(index, cell, levels);
  const bound = chunk && view >= 0 ? chunk.viewCost[view] : manifest.worst_nonproblem;
  return {
    cell,
    interval,
    problemView: chunk && view >= 0 ? chunk.views[0] + view : null,
    hopeless: chunk !== null && view >= 0 && chunk.viewHopeless[view] !== 0,
    impostors,
    objects,
    levels: objects.map((o) => levels[o]),
    costBound: manifest.cost_model.per_frame + bound,
  };
}

async function fetchContainer(fetchBytes: FetchBytes, entry: FileEntry, signal?: AbortSignal): Promise<Container> {
  return unpackFile(await fetchChecked(fetchBytes, entry, signal), entry.file, entry.expanded);
}

/** Fetches a file and checks size, then digest; throws what the format's section 7 says, once it came damaged twice. */
async function fetchChecked(fetchBytes: FetchBytes, entry: FileEntry, signal?: AbortSignal): Promise<Uint8Array> {
  const fetched = async (anew: boolean): Promise<Uint8Array> => {
    const bytes = await fetchBytes(entry.file, signal, anew);
    if (!bytes) throw new PlacementFileMissing(entry.file);
    await checkFile(bytes, entry);
    return bytes;
  };
  try {
    return await fetched(false);
  } catch (error) {
    // Cut off or altered on the way, or in a cache on the way: the line may be at fault, not the file.
    if (error instanceof ColumnsTruncated || error instanceof ColumnsAltered) return fetched(true);
    throw error;
  }
}

async function checkFile(bytes: Uint8Array, entry: FileEntry): Promise<void> {
  if (bytes.length < entry.bytes) throw new ColumnsTruncated(entry.file, bytes.length, entry.bytes);
  if (bytes.length > entry.bytes) throw new ColumnsAltered(entry.file, `it has ${bytes.length} bytes, not ${entry.bytes}`);
  if ((await sha256(bytes)) !== entry.sha256) throw new ColumnsAltered(entry.file, "its SHA-256 is not the one in the manifest");
}
