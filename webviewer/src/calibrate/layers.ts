/** Impostor layers for controlled frames: quads that face the camera, drawn in the viewer's own one call, back to front. */
import { ImpostorLayers, type DrawStats } from "../draw/draw_impostor_layers";
import type { View } from "../draw/view";
import { ChunkBuffers } from "../gl/chunk_buffers";
import type { PageArray } from "../gl/page_array";
import type { PlacementChunk } from "../placementdb/chunk";
import { halton, rectangle, type Load } from "./plan";

const PAGE = 1024;
const LEVELS = 4;
const NEAREST_M = 110; // behind all objects: the viewer draws impostors first
const FARTHEST_M = 300;

export class Layers {
  private readonly layers: ImpostorLayers;
  private readonly pages: PageArray;
  private buffers: ChunkBuffers | null = null;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.layers = new ImpostorLayers(gl);
    this.pages = page(gl);
  }

  /** Lays the layers of a frame out; returns what they come to: pixels are those that their polygons cover. */
  prepare(load: Load, view: View, width: number, height: number): { impostors: number; impostor_triangles: number; impostor_pixels: number } {
    this.buffers?.dispose();
    this.buffers = null;
    const impostors = load.impostors;
    const quads = Math.max(impostors, Math.round(load.impostor_triangles / 2));
    const shown = Array.from({ length: impostors }, (_, m) => m);
    const [wide, high] = rectangle(quads ? load.impostor_pixels / quads : 1, width, height);
    if (impostors) {
      const chunk = chunkOf(impostors, quads, (r) => {
        const far = FARTHEST_M - ((FARTHEST_M - NEAREST_M) * r) / quads;
        const unit = (2 * far * view.tanY) / height;
        const x = (halton(r + 1, 2) - 0.5) * (width - wide) * unit;
        const y = (halton(r + 1, 3) - 0.5) * (height - high) * unit;
        return [x, y, -far, (wide * unit) / 2, (high * unit) / 2];
      }, Math.min(PAGE - 4, wide), Math.min(PAGE - 4, high));
      this.buffers = new ChunkBuffers(this.gl, chunk, [0, 0, 0], this.layers.indexBuffer);
    }
    this.layers.setShown(this.buffers, shown);
    return { impostors, impostor_triangles: impostors ? 2 * quads : 0, impostor_pixels: impostors ? Math.round(quads * wide * high) : 0 };
  }

  draw(view: View, stats: DrawStats): void {
    this.layers.draw(view, this.pages, [0, 0, 0], stats);
  }
}

/** A chunk of these quads; `place` says middle and half sizes of quad r, metres in camera axes, the camera at the origin. */
function chunkOf(impostors: number, quads: number, place: (r: number) => [number, number, number, number, number], uvWide: number, uvHigh: number): PlacementChunk {
  const corner = new Float32Array(12 * quads);
  const uv = new Float32Array(8 * quads);
  for (let r = 0; r < quads; r++) {
    const [x, y, z, w, h] = place(r);
    corner.set([x - w, y - h, z, x + w, y - h, z, x + w, y + h, z, x - w, y + h, z], 12 * r);
    uv.set([0, 0, uvWide, 0, uvWide, uvHigh, 0, uvHigh], 8 * r);
  }
  const filled = (value: number): Float64Array => new Float64Array(quads).fill(value);
  const rect = new Uint16Array(4 * quads);
  for (let r = 0; r < quads; r++) rect.set([0, 0, PAGE, PAGE], 4 * r);
  const held: Partial<PlacementChunk> = {
    impostorId: Int32Array.from({ length: impostors }, (_, m) => m), impostorEye: new Float64Array(3 * impostors),
    impostorLayer: Int32Array.from({ length: impostors + 1 }, (_, m) => Math.floor((m * quads) / impostors)),
    layerNumber: new Uint16Array(quads), layerPlane: filled(1), layerInverseNear: filled(1), layerInverseFar: filled(1),
    layerPage: new Int32Array(quads), layerRect: rect, layerCorner: Int32Array.from({ length: quads + 1 }, (_, r) => 4 * r), cornerPosition: corner, cornerUv: uv,
  };
  return held as PlacementChunk; // all that is laid out of one
}

/** One page that covers everything, with its levels. */
function page(gl: WebGL2RenderingContext): PageArray {
  const texture = gl.createTexture()!;
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, LEVELS, gl.SRGB8_ALPHA8, PAGE, PAGE, 1);
  for (let level = 0; level < LEVELS; level++) {
    const size = PAGE >> level;
    const texels = new Uint8Array(4 * size * size);
    for (let i = 0; i < texels.length; i += 4) texels.set([((i >> 4) * 7) & 255, 120, 90, 252], i); // alpha: nearest, all four quarters
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, level, 0, 0, 0, size, size, 1, gl.RGBA, gl.UNSIGNED_BYTE, texels);
  }
  gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST_MIPMAP_NEAREST);
  gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAX_LEVEL, LEVELS - 1);
  const slotTexture = gl.createTexture()!;
  gl.bindTexture(gl.TEXTURE_2D, slotTexture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16I, 1, 1, 0, gl.RED_INTEGER, gl.SHORT, new Int16Array([0]));
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return { texture, slotTexture } as PageArray; // all that drawing reads of one
}
