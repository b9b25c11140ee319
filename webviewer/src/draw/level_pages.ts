/**
 * The level's pages and textures that are here, under a cap of bytes; least recently wanted go first.
 *
 * A *part* of the level is a page (0 to pages - 1) or a texture file (after them). All models of a page share its buffers.
 */
import * as THREE from "three";
import type { GeometryIndex, GeometryPage } from "../placementdb/geometry";
import type { GeometryEntry } from "../placementdb/manifest";
import type { PagedMaterials } from "./materials";

const SHORT_VERTICES = 1 << 16;

export class LevelPages {
  readonly partBytes: Float64Array;
  /** Geometries of each model, primitive by primitive; null: not here. */
  readonly models: (THREE.BufferGeometry[] | null)[];
  bytes = 0;
  mostBytes = 0; // that were here at once
  evictions = 0;
  /** Rises whenever a part comes or goes. */
  version = 0;
  private readonly here: Uint8Array;
  private readonly wantedAt: Float64Array;
  private tick = 0;
  private readonly pageModels: Int32Array[]; // by slot

  constructor(
    private readonly entry: GeometryEntry,
    index: GeometryIndex,
    private readonly materials: PagedMaterials,
    readonly capBytes: number,
  ) {
    const { pages, textures } = entry;
    // A texture takes four bytes a texel, and a third of that again for its mip levels.
    this.partBytes = Float64Array.from([...pages.map((p) => p.memory), ...textures.map((t) => Math.ceil((16 * t.width * t.height) / 3))]);
    this.here = new Uint8Array(this.partBytes.length);
    this.wantedAt = new Float64Array(this.partBytes.length);
    this.models = new Array(index.modelPage.length).fill(null);
    const slots: number[][] = pages.map(() => []);
    index.modelPage.forEach((page, q) => {
      if (page >= 0) slots[page][index.modelSlot[q]] = q;
    });
    this.pageModels = slots.map((list) => Int32Array.from(list));
  }

  get parts(): number {
    return this.partBytes.length;
  }

  get resident(): number {
    let n = 0;
    for (const h of this.here) n += h;
    return n;
  }

  isResident(part: number): boolean {
    return this.here[part] === 1;
  }

  want(part: number): void {
    this.wantedAt[part] = ++this.tick;
  }

  /** Takes a page in, unless parts that are wanted leave no room. */
  putPage(part: number, page: GeometryPage, wanted: (part: number) => boolean): boolean {
    if (!this.makeRoom(part, wanted)) return false;
    const attributes = new Map<string, THREE.BufferAttribute>();
    const add = (name: string, array: Float32Array, size: number): void => {
      if (array.length) attributes.set(name, released(new THREE.BufferAttribute(array, size)));
    };
    add("position", page.position, 3);
    add("normal", page.normal, 3);
    add("uv", page.uv, 2);
    add("uv1", page.glowUv, 2);
    add("color", page.color, 4);
    const short = page.position.length / 3 <= SHORT_VERTICES;
    const index = released(new THREE.BufferAttribute(short ? Uint16Array.from(page.index) : page.index, 1));
    this.pageModels[part].forEach((model, slot) => {
      const geometries: THREE.BufferGeometry[] = [];
      for (let r = page.modelPart[slot]; r < page.modelPart[slot + 1]; r++) {
        const geometry = new THREE.BufferGeometry();
        for (const [name, attribute] of attributes) geometry.setAttribute(name, attribute);
        geometry.setIndex(index);
        geometry.setDrawRange(3 * page.partTriangle[r], 3 * (page.partTriangle[r + 1] - page.partTriangle[r]));
        geometry.boundingSphere = sphereOf(page, r);
        geometries.push(geometry);
      }
      this.models[model] = geometries;
    });
    return true;
  }

  /** Takes an image in, or closes it where there is no room. */
  putTexture(part: number, image: ImageBitmap, wanted: (part: number) => boolean): boolean {
    if (!this.makeRoom(part, wanted)) {
      image.close();
      return false;
    }
    this.materials.setFile(part - this.entry.pages.length, image);
    return true;
  }

  private makeRoom(part: number, wanted: (part: number) => boolean): boolean {
    while (this.bytes + this.partBytes[part] > this.capBytes) {
      let oldest = -1;
      for (let p = 0; p < this.parts; p++) {
        if (this.here[p] && !wanted(p) && (oldest < 0 || this.wantedAt[p] < this.wantedAt[oldest])) oldest = p;
      }
      if (oldest < 0) {
        if (this.bytes > 0) return false;
        break; // one part alone may exceed the cap: better than nothing
      }
      this.drop(oldest);
    }
    this.here[part] = 1;
    this.bytes += this.partBytes[part];
    this.mostBytes = Math.max(this.mostBytes, this.bytes);
    this.wantedAt[part] = ++this.tick;
    this.version++;
    return true;
  }

  private drop(part: number): void {
    this.here[part] = 0;
    this.bytes -= this.partBytes[part];
    this.evictions++;
    this.version++;
    if (part >= this.entry.pages.length) return this.materials.setFile(part - this.entry.pages.length, null);
    for (const model of this.pageModels[part]) {
      for (const geometry of this.models[model] ?? []) geometry.dispose(); // the first takes the page's buffers with it
      this.models[model] = null;
    }
  }
}

/** Its array is let go once video memory has it. */
function released(attribute: THREE.BufferAttribute): THREE.BufferAttribute {
  attribute.onUpload(function (this: THREE.BufferAttribute) {
    (this as { array: unknown }).array = null;
  });
  return attribute;
}

/** Around the middle of a part's vertices: three.js sorts blended ones by it. */
function sphereOf(page: GeometryPage, part: number): THREE.Sphere {
  const box = new THREE.Box3();
  const point = new THREE.Vector3();
  for (let k = 3 * page.partTriangle[part]; k < 3 * page.partTriangle[part + 1]; k++) {
    box.expandByPoint(point.fromArray(page.position, 3 * page.index[k]));
  }
  return box.getBoundingSphere(new THREE.Sphere());
}
