/**
 * Fetches what the plan wants, a few files at a time; cancels what is no longer wanted; hands what has arrived to video memory.
 *
 * A file that arrives damaged is not asked for again: what it holds is drawn in other ways, and the page says so.
 */
import type { LevelMesh } from "../draw/draw_mesh";
import { decodePage, dropPage, type DecodedPage, type PageArray } from "../gl/page_array";
import { PlacementFileError } from "../placementdb/errors";
import type { GeometryPage } from "../placementdb/geometry";
import type { Placement } from "../placementdb/placement";
import { DEFAULT_CAPS } from "./caps";
import { AccessDenied } from "./files";
import type { PartsWanted } from "./level_plan";
import { plan, type Plan } from "./plan";

const AT_ONCE = 4;
const NOTHING: PartsWanted = { parts: [], urgent: 0, near: 0 };

type Arrived = { page: number; content: DecodedPage } | { part: number; geometry: GeometryPage } | { part: number; image: ImageBitmap };

export class Streamer {
  readonly damaged = new Map<string, string>(); // file -> why
  denied: AccessDenied | null = null;
  plan: Plan = { chunks: [], pages: [] };
  parts: PartsWanted = NOTHING;
  mostChunkBytes = 0; // that were here at once
  /** False: nothing is fetched but what the view cannot do without. */
  prefetching = true;
  private wanted: ReadonlySet<number> = new Set();
  private wantedParts: ReadonlySet<number> = new Set();
  /** Numbers of files, best first: chunks, then pages, then parts of the level. */
  private order: number[] = [];
  private next = 0; // what stands before is here, on its way or damaged
  private readonly flying = new Map<number, AbortController>();
  private readonly arrived: Arrived[] = [];
  private readonly firstPage: number;
  private readonly firstPart: number;
  private readonly isWantedPart = (part: number): boolean => this.wantedParts.has(part);

  constructor(
    private readonly placement: Placement,
    private readonly pages: PageArray,
    private readonly onChange: () => void,
    private readonly level: LevelMesh | null = null,
    private readonly chunkBytesCap = DEFAULT_CAPS.chunks,
  ) {
    this.firstPage = placement.manifest.chunks.length;
    this.firstPart = this.firstPage + placement.manifest.pages.length;
  }

  get inFlight(): number {
    return this.flying.size;
  }

  get waitingForUpload(): number {
    return this.arrived.length;
  }

  /** Nothing wanted is missing. */
  get complete(): boolean {
    return !this.flying.size && !this.arrived.length && this.order.every((file) => this.isHere(file) || this.damaged.has(this.nameOf(file)));
  }

  /** Everything that the placement holds is here. */
  get whole(): boolean {
    const { manifest } = this.placement;
    const level = this.level?.pages;
    return manifest.chunks.every((_, k) => this.placement.residentChunk(k)) && this.pages.residentPages === manifest.pages.length && (!level || level.resident === level.parts);
  }

  /** A page that is resident, or never will be: damaged, or beyond what video memory holds (its impostors stay geometry). */
  settled(page: number): boolean {
    return this.pages.isResident(page) || !this.wanted.has(page) || this.damaged.has(this.placement.manifest.pages[page].file);
  }

  /** What the view draws as geometry is here, as far as it can be. */
  get levelSettled(): boolean {
    for (let k = 0; k < this.parts.urgent; k++) {
      const file = this.firstPart + this.parts.parts[k];
      if (!this.isHere(file) && !this.damaged.has(this.nameOf(file))) return false;
    }
    return true;
  }

  /** Called when the cell or view changes, and now and then while the camera moves; the first `needed` likely pages are in view. */
  update(current: number, likely: Iterable<number>, ahead: ArrayLike<number>, parts: PartsWanted = NOTHING, needed = 0): void {
    const { placement, firstPage, firstPart } = this;
    this.plan = plan(placement.manifest, current, likely, ahead, this.pages.slots, this.chunkBytesCap);
    this.parts = parts;
    this.wanted = new Set(this.plan.pages);
    this.wantedParts = new Set(parts.parts);
    for (let k = parts.parts.length - 1; k >= 0; k--) this.level!.pages!.want(parts.parts[k]);
    const { chunks, pages } = this.plan;
    const page = (p: number): number => firstPage + p;
    const part = (p: number): number => firstPart + p;
    // What the view cannot do without, then what turning and going on need, then the rest.
    this.order = [...chunks.slice(0, 1), ...parts.parts.slice(0, parts.urgent).map(part), ...pages.slice(0, needed).map(page)];
    if (this.prefetching) {
      this.order.push(
        ...chunks.slice(1, 2), ...parts.parts.slice(parts.urgent, parts.near).map(part), ...pages.slice(needed).map(page),
        ...chunks.slice(2), ...parts.parts.slice(parts.near).map(part),
      );
    }
    this.next = 0;
    const keep = new Set(this.order);
    for (const [file, controller] of this.flying) if (!keep.has(file)) controller.abort(new DOMException("no longer wanted", "AbortError"));
    for (let k = 0; k < firstPage; k++) if (!keep.has(k) && placement.residentChunk(k)) placement.dropChunk(k);
    this.pump();
  }

  /** Moves up to `most` of what has arrived into video memory; called once a frame. */
  upload(most: number): void {
    if (!this.arrived.length) return;
    for (let n = 0; n < most && this.arrived.length; n++) this.take(this.arrived.shift()!);
    this.pump();
    this.onChange();
  }

  private take(a: Arrived): void {
    if ("page" in a) {
      if (this.wanted.has(a.page) && !this.pages.isResident(a.page)) this.pages.put(a.page, a.content, this.wanted);
      dropPage(a.content);
    } else if (!this.wantedParts.has(a.part) || this.level!.pages!.isResident(a.part)) {
      if ("image" in a) a.image.close();
    } else if ("image" in a) {
      this.level!.pages!.putTexture(a.part, a.image, this.isWantedPart);
    } else {
      this.level!.pages!.putPage(a.part, a.geometry, this.isWantedPart);
    }
  }

  private isHere(file: number): boolean {
    if (file < this.firstPage) return this.placement.residentChunk(file) !== undefined;
    return file < this.firstPart ? this.pages.isResident(file - this.firstPage) : this.level!.pages!.isResident(file - this.firstPart);
  }

  private hasArrived(file: number): boolean {
    for (const a of this.arrived) if (file === ("page" in a ? this.firstPage + a.page : this.firstPart + a.part)) return true;
    return false;
  }

  private nameOf(file: number): string {
    const { chunks, pages, geometry } = this.placement.manifest;
    if (file < this.firstPage) return chunks[file].file;
    if (file < this.firstPart) return pages[file - this.firstPage].file;
    const part = file - this.firstPart;
    const n = geometry!.pages.length;
    return part < n ? geometry!.pages[part].file : geometry!.textures[part - n].file;
  }

  private pump(): void {
    if (this.denied) return;
    for (; this.next < this.order.length && this.flying.size < AT_ONCE; this.next++) {
      const file = this.order[this.next];
      if (!this.isHere(file) && !this.flying.has(file) && !this.hasArrived(file) && !this.damaged.has(this.nameOf(file))) this.start(file);
    }
  }

  private start(file: number): void {
    const controller = new AbortController();
    this.flying.set(file, controller);
    this.fetch(file, controller.signal)
      .catch((error: unknown) => {
        if (controller.signal.aborted) return;
        const name = this.nameOf(file);
        if (error instanceof AccessDenied) this.denied = error;
        else this.damaged.set(name, error instanceof PlacementFileError ? error.message : `${name}: ${String(error)}`);
      })
      .finally(() => {
        this.flying.delete(file);
        if (controller.signal.aborted) this.next = 0; // it may be wanted again by now
        this.pump();
      });
  }

  private async fetch(file: number, signal: AbortSignal): Promise<void> {
    const { placement, firstPage, firstPart } = this;
    if (file < firstPage) {
      await placement.chunk(file, signal);
      this.countChunks();
      this.onChange();
    } else if (file < firstPart) {
      const page = file - firstPage;
      const content = await decodePage(await placement.page(page, signal), placement.manifest.page);
      if (signal.aborted) dropPage(content);
      else this.arrived.push({ page, content });
    } else {
      const part = file - firstPart;
      const n = placement.manifest.geometry!.pages.length;
      if (part < n) {
        const geometry = await placement.geometryPage(part, signal);
        if (!signal.aborted) this.arrived.push({ part, geometry });
      } else {
        const bytes = await placement.texture(part - n, signal);
        const image = await createImageBitmap(new Blob([bytes as Uint8Array<ArrayBuffer>]), { premultiplyAlpha: "none", colorSpaceConversion: "none" });
        if (signal.aborted) image.close();
        else this.arrived.push({ part, image });
      }
    }
  }

  private countChunks(): void {
    let bytes = 0;
    this.placement.manifest.chunks.forEach((entry, k) => {
      if (this.placement.residentChunk(k)) bytes += entry.expanded ?? entry.bytes;
    });
    this.mostChunkBytes = Math.max(this.mostChunkBytes, bytes);
  }
}
