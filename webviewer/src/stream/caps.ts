/** How much of what is streamed may be resident at once. */
import type { Manifest } from "../placementdb/manifest";

export interface Caps {
  chunks: number; // bytes of chunks
  pages: number; // bytes of impostor pages in video memory
  level: number; // bytes of geometry and textures in video memory
}

/** What suits most devices. */
export const DEFAULT_CAPS: Caps = { chunks: 256 * 2 ** 20, pages: 384 * 2 ** 20, level: 512 * 2 ** 20 };

/** What the placement would take as a whole. */
export function heldBytes(manifest: Manifest): Caps {
  const perPage = manifest.page.levels.reduce((sum, l) => sum + 4 * l.size * l.size, 0);
  const geometry = manifest.geometry;
  const textures = (geometry?.textures ?? []).reduce((sum, t) => sum + Math.ceil((16 * t.width * t.height) / 3), 0);
  return {
    chunks: manifest.chunks.reduce((sum, c) => sum + (c.expanded ?? c.bytes), 0),
    pages: manifest.pages.length * perPage,
    level: (geometry?.pages ?? []).reduce((sum, p) => sum + p.memory, textures),
  };
}

/**
 * `memoryMb`: all of it together; null: DEFAULT_CAPS. The level comes first, up to half: without impostors a view
 * is slow, without geometry it is boxes. Chunks and pages share the rest as the placement is made.
 */
export function capsOf(manifest: Manifest, memoryMb: number | null): Caps {
  if (memoryMb === null || !(memoryMb > 0)) return DEFAULT_CAPS;
  const held = heldBytes(manifest);
  const all = memoryMb * 1e6;
  const level = Math.min(held.level, all / 2);
  const share = (all - level) / Math.max(1, held.chunks + held.pages);
  return { chunks: share * held.chunks, pages: share * held.pages, level };
}
