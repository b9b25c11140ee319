/**
 * Atlas pages in video memory: one texture array with stored mip levels, a slot a page, least recently used goes first.
 *
 * The shader finds a page's slot in a small integer texture, so vertex buffers never change when pages come and go.
 */
import type { Manifest } from "../placementdb/manifest";
import { readKtx2 } from "./ktx2";

const SLOTS_WIDTH = 1024;

/** A page as it is uploaded: an image that holds all levels, or the bytes of each. */
export type DecodedPage = ImageBitmap | Uint8Array[];

export class PageArray {
  readonly texture: WebGLTexture;
  readonly slotTexture: WebGLTexture;
  readonly slots: number;
  readonly bytesPerPage: number;
  /** Rises whenever a page comes or goes. */
  version = 0;
  private readonly slotOf: Int16Array;
  private readonly pageIn: Int32Array;
  private readonly usedAt: Float64Array;
  private tick = 0;
  private readonly gl: WebGL2RenderingContext;
  private readonly layout: Manifest["page"];

  constructor(gl: WebGL2RenderingContext, manifest: Manifest, capBytes: number) {
    this.gl = gl;
    this.layout = manifest.page;
    const { levels, size } = manifest.page;
    this.bytesPerPage = levels.reduce((sum, l) => sum + 4 * l.size * l.size, 0);
    const pages = manifest.pages.length;
    const most = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS) as number;
    let slots = Math.max(1, Math.min(pages, most, Math.floor(capBytes / this.bytesPerPage)));
    this.texture = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levels.length, gl.SRGB8_ALPHA8, size, size, slots);
    while (gl.getError() === gl.OUT_OF_MEMORY && slots > 1) {
      // Storage is immutable, so that a smaller one needs a new texture.
      slots >>= 1;
      gl.deleteTexture(this.texture);
      this.texture = gl.createTexture()!;
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
      gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levels.length, gl.SRGB8_ALPHA8, size, size, slots);
    }
    this.slots = slots;
    this.pageIn = new Int32Array(this.slots).fill(-1);
    this.usedAt = new Float64Array(this.slots);
    this.slotOf = new Int16Array(SLOTS_WIDTH * Math.max(1, Math.ceil(pages / SLOTS_WIDTH))).fill(-1);
    // Alpha is fetched by texel; colour is filtered within one level, the shader mixes two.
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAX_LEVEL, levels.length - 1);
    this.slotTexture = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, this.slotTexture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.writeSlots();
  }

  isResident(page: number): boolean {
    return this.slotOf[page] >= 0;
  }

  get residentPages(): number {
    let n = 0;
    for (const p of this.pageIn) if (p >= 0) n++;
    return n;
  }

  touch(page: number): void {
    const slot = this.slotOf[page];
    if (slot >= 0) this.usedAt[slot] = ++this.tick;
  }

  /** Puts a decoded page into a free slot, or that of the least recently used page outside `keep`; false: none is free. */
  put(page: number, decoded: DecodedPage, keep: ReadonlySet<number>): boolean {
    let slot = this.pageIn.indexOf(-1);
    if (slot < 0) {
      for (let s = 0; s < this.slots; s++) {
        if (!keep.has(this.pageIn[s]) && (slot < 0 || this.usedAt[s] < this.usedAt[slot])) slot = s;
      }
      if (slot < 0) return false;
      this.slotOf[this.pageIn[slot]] = -1;
    }
    this.pageIn[slot] = page;
    this.slotOf[page] = slot;
    this.usedAt[slot] = ++this.tick;
    this.upload(slot, decoded);
    this.writeSlots();
    this.version++;
    return true;
  }

  /** Bytes (RGBA, level after level) of a resident page as they lie in video memory: for tests. */
  read(page: number): Uint8Array[] {
    const { gl } = this;
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    const levels = this.layout.levels.map((level, k) => {
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, this.texture, k, this.slotOf[page]);
      const out = new Uint8Array(4 * level.size * level.size);
      gl.readPixels(0, 0, level.size, level.size, gl.RGBA, gl.UNSIGNED_BYTE, out);
      return out;
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    return levels;
  }

  private upload(slot: number, decoded: DecodedPage): void {
    const { gl } = this;
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    this.layout.levels.forEach(({ x, y, size }, k) => {
      if (Array.isArray(decoded)) {
        gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, k, 0, 0, slot, size, size, 1, gl.RGBA, gl.UNSIGNED_BYTE, decoded[k]);
        return;
      }
      gl.pixelStorei(gl.UNPACK_SKIP_PIXELS, x);
      gl.pixelStorei(gl.UNPACK_SKIP_ROWS, y);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, k, 0, 0, slot, size, size, 1, gl.RGBA, gl.UNSIGNED_BYTE, decoded);
    });
    gl.pixelStorei(gl.UNPACK_SKIP_PIXELS, 0);
    gl.pixelStorei(gl.UNPACK_SKIP_ROWS, 0);
  }

  private writeSlots(): void {
    const { gl } = this;
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
    gl.bindTexture(gl.TEXTURE_2D, this.slotTexture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16I, SLOTS_WIDTH, this.slotOf.length / SLOTS_WIDTH, 0, gl.RED_INTEGER, gl.SHORT, this.slotOf);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
  }
}

/** Decodes a page without touching colour under small alpha: neither premultiplied nor colour managed. */
export async function decodePage(bytes: Uint8Array, page: Manifest["page"]): Promise<DecodedPage> {
  if (page.format === "ktx2") return readKtx2(bytes, page.levels.map((level) => level.size));
  const bitmap = await createImageBitmap(new Blob([bytes as Uint8Array<ArrayBuffer>], { type: `image/${page.format ?? "webp"}` }), {
    premultiplyAlpha: "none", colorSpaceConversion: "none", imageOrientation: "none" as ImageOrientation,
  });
  if (bitmap.width !== page.width || bitmap.height !== page.height) throw new Error(`its image has ${bitmap.width} x ${bitmap.height} texels`);
  return bitmap;
}

export function dropPage(decoded: DecodedPage): void {
  if (!Array.isArray(decoded)) decoded.close();
}
