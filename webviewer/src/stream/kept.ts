/**
 * Files of a placement that this browser keeps, so that it opens again while the service cannot be reached.
 *
 * They are private: whoever signs in or out has them all dropped (`forgetFiles`), as has a session that the service refuses.
 * Nothing kept is shown before the service was asked for the manifest, unless it gives no answer at all. What a file holds is
 * checked against the manifest's digest like any other, so a kept file is never trusted more than one that was fetched.
 */
import { sha256 } from "../placementdb/sha256";

const PREFIX = "farfield placement ";
const MOST_PLACEMENTS = 4;
const MOST_BYTES = 2 ** 30; // of this origin, and never more than half of what the browser allows
const MANIFEST = "manifest.json";
const DIGEST_NAMED = /([0-9a-f]{16})\.\w+$/; // such a file never changes

/** Whether its name has the digest of what it holds: what is damaged is fetched again. */
async function isIntact(name: string, bytes: Uint8Array): Promise<boolean> {
  const digest = DIGEST_NAMED.exec(name);
  return !digest || (await sha256(bytes)).startsWith(digest[1]);
}

/** Drops what was kept of every placement. */
export async function forgetFiles(): Promise<void> {
  if (!globalThis.caches) return; // only secure contexts and localhost have it
  for (const name of await caches.keys()) if (name.startsWith(PREFIX)) await caches.delete(name);
}

export class KeptFiles {
  private constructor(
    private readonly cache: Cache,
    private readonly base: string,
    private readonly names: Set<string>,
    private room: number,
  ) {}

  /** Null where the browser keeps nothing. */
  static async open(base: string): Promise<KeptFiles | null> {
    try {
      const own = PREFIX + base;
      const others = (await caches.keys()).filter((name) => name.startsWith(PREFIX) && name !== own);
      for (const name of others.slice(0, Math.max(0, others.length - MOST_PLACEMENTS + 1))) await caches.delete(name); // made first
      const cache = await caches.open(own);
      const names = (await cache.keys()).map((request) => decodeURI(new URL(request.url).pathname).slice(decodeURI(base).length));
      const { usage = 0, quota = 0 } = await navigator.storage.estimate();
      return new KeptFiles(cache, base, new Set(names), Math.min(MOST_BYTES, quota / 2) - usage);
    } catch {
      return null; // not a secure context, or storage is forbidden
    }
  }

  /** A file that may be taken without asking the service. */
  async digestNamed(name: string): Promise<Uint8Array | null> {
    return DIGEST_NAMED.test(name) ? this.get(name) : null;
  }

  async get(name: string): Promise<Uint8Array | null> {
    if (!this.names.has(name)) return null;
    const found = await this.cache.match(this.base + name).catch(() => undefined);
    const bytes = found && new Uint8Array(await found.arrayBuffer());
    if (bytes && (await isIntact(name, bytes))) return bytes;
    this.names.delete(name);
    return null;
  }

  /** Keeps a file, where there is room; a manifest that differs from the kept one drops what belonged to that. */
  async put(name: string, bytes: Uint8Array): Promise<void> {
    if (name === MANIFEST) {
      const before = await this.get(name);
      if (before && before.length === bytes.length && before.every((x, k) => x === bytes[k])) return;
      await this.clear();
    }
    if ((this.names.has(name) && DIGEST_NAMED.test(name)) || !(await isIntact(name, bytes))) return;
    if ((this.room -= bytes.length) < 0) return;
    this.names.add(name);
    // A full disk, or a cache that was dropped by now, only means that it is fetched again.
    await this.cache.put(this.base + name, new Response(bytes as Uint8Array<ArrayBuffer>)).catch(() => this.names.delete(name));
  }

  async clear(): Promise<void> {
    for (const name of this.names) await this.cache.delete(this.base + name).catch(() => false);
    this.names.clear();
  }
}
