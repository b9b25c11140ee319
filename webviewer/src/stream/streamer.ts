/**
 * Fetches what the plan wants, a few files at a time; cancels what is no longer wanted; hands decoded pages to video memory.
 *
 * A file that arrives damaged is not asked for again: its impostors stay geometry, and the page says so.
 */
import { decodePage, dropPage, type DecodedPage, type PageArray } from "../gl/page_array";
import { PlacementFileError } from "../placementdb/errors";
import type { Placement } from "../placementdb/placement";
import { AccessDenied } from "./files";
import { plan, type Plan } from "./plan";

const AT_ONCE = 4;
export const CHUNK_BYTES_CAP = 256 * 2 ** 20;

export class Streamer {
  readonly damaged = new Map<string, string>(); // file -> why
  denied: AccessDenied | null = null;
  plan: Plan = { chunks: [], pages: [] };
  private wanted: ReadonlySet<number> = new Set();
  private readonly flying = new Map<string, AbortController>();
  private readonly decoded: { page: number; content: DecodedPage }[] = [];
  private readonly placement: Placement;
  private readonly pages: PageArray;
  private readonly onChunk: () => void;

  constructor(placement: Placement, pages: PageArray, onChunk: () => void) {
    this.placement = placement;
    this.pages = pages;
    this.onChunk = onChunk;
  }

  get inFlight(): number {
    return this.flying.size;
  }

  get waitingForUpload(): number {
    return this.decoded.length;
  }

  /** Nothing wanted is missing. */
  get complete(): boolean {
    return (
      !this.flying.size && !this.decoded.length &&
      this.plan.chunks.every((k) => this.placement.residentChunk(k) || this.damaged.has(this.placement.manifest.chunks[k].file)) &&
      this.plan.pages.every((p) => this.settled(p))
    );
  }

  /** A page that is resident, or never will be: damaged, or beyond what video memory holds (its impostors stay geometry). */
  settled(page: number): boolean {
    return this.pages.isResident(page) || !this.wanted.has(page) || this.damaged.has(this.placement.manifest.pages[page].file);
  }

  /** Called when the cell or view changes, and now and then while the camera moves. */
  update(current: number, likely: Iterable<number>, ahead: ArrayLike<number>): void {
    this.plan = plan(this.placement.manifest, current, likely, ahead, this.pages.slots, CHUNK_BYTES_CAP);
    this.wanted = new Set(this.plan.pages);
    const keep = new Set(this.plan.chunks.map((k) => `chunk ${k}`));
    for (const [key, controller] of this.flying) {
      const stillWanted = key.startsWith("page ") ? this.wanted.has(Number(key.slice(5))) : keep.has(key);
      if (!stillWanted) controller.abort(new DOMException("no longer wanted", "AbortError"));
    }
    for (let k = 0; k < this.placement.manifest.chunks.length; k++) {
      if (!keep.has(`chunk ${k}`) && this.placement.residentChunk(k)) this.placement.dropChunk(k);
    }
    this.pump();
  }

  /** Moves up to `most` decoded pages into video memory; called once a frame. */
  upload(most: number): void {
    if (!this.decoded.length) return;
    for (let n = 0; n < most && this.decoded.length; n++) {
      const { page, content } = this.decoded.shift()!;
      if (this.wanted.has(page) && !this.pages.isResident(page)) this.pages.put(page, content, this.wanted);
      dropPage(content);
    }
    this.pump();
  }

  private pump(): void {
    if (this.denied) return;
    const { placement } = this;
    const { chunks, pages } = placement.manifest;
    // The chunk of the current cell goes first; then pages and the other chunks share the line, pages first.
    const jobs: [string, string, (signal: AbortSignal) => Promise<void>][] = [];
    const chunkJob = (k: number): void => {
      if (!placement.residentChunk(k)) jobs.push([`chunk ${k}`, chunks[k].file, (signal) => this.fetchChunk(k, signal)]);
    };
    if (this.plan.chunks.length) chunkJob(this.plan.chunks[0]);
    for (const p of this.plan.pages) {
      if (jobs.length >= 2 * AT_ONCE) break;
      if (!this.pages.isResident(p) && !this.decoded.some((d) => d.page === p)) {
        jobs.push([`page ${p}`, pages[p].file, (signal) => this.fetchPage(p, signal)]);
      }
    }
    for (const k of this.plan.chunks.slice(1)) if (jobs.length < 2 * AT_ONCE) chunkJob(k);
    for (const [key, file, run] of jobs) {
      if (this.flying.size >= AT_ONCE) break;
      if (!this.flying.has(key) && !this.damaged.has(file)) this.start(key, file, run);
    }
  }

  private start(key: string, file: string, run: (signal: AbortSignal) => Promise<void>): void {
    const controller = new AbortController();
    this.flying.set(key, controller);
    run(controller.signal)
      .catch((error: unknown) => {
        if (controller.signal.aborted) return;
        if (error instanceof AccessDenied) this.denied = error;
        else this.damaged.set(file, error instanceof PlacementFileError ? error.message : `${file}: ${String(error)}`);
      })
      .finally(() => {
        this.flying.delete(key);
        this.pump();
      });
  }

  private async fetchChunk(k: number, signal: AbortSignal): Promise<void> {
    await this.placement.chunk(k, signal);
    this.onChunk();
  }

  private async fetchPage(page: number, signal: AbortSignal): Promise<void> {
    const bytes = await this.placement.page(page, signal);
    const content = await decodePage(bytes, this.placement.manifest.page);
    if (signal.aborted) dropPage(content);
    else this.decoded.push({ page, content });
  }
}
