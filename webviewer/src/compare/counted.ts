/**
 * A WebGL2 context that counts: what is drawn, and what lies in video memory. Every way to draw is held to the same count.
 *
 * Counts what reaches WebGL, whoever called it. A multi-draw is one call; its parts are counted apart. Bytes are those of buffers and
 * textures as they were asked for; what a driver adds is not known here. Render buffers are left out: each way draws into the same.
 */

export interface Counts {
  calls: number;
  parts: number; // draws inside multi-draws, and every other call as one
  triangles: number;
}

const COUNT = ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced", "drawRangeElements"] as const;
type Any = (...given: never[]) => unknown;

const TEXEL_BYTES: Record<number, number> = {
  0x8058: 4, 0x8c43: 4, 0x8051: 4, 0x8c41: 4, 0x8814: 16, 0x881a: 8, 0x8233: 2, 0x8235: 4, 0x8236: 4, 0x822e: 4, 0x8229: 1, 0x822b: 2,
  0x8227: 4, 0x8230: 8, 0x8d70: 16, 0x1908: 4, 0x1907: 4, 0x8d94: 1, 0x8d8f: 1, 0x8232: 1, 0x8231: 1, 0x8d99: 4, 0x8d8e: 4, 0x8d7c: 4, 0x81a6: 4,
};

export class Counted implements Counts {
  calls = 0;
  parts = 0;
  triangles = 0;
  /** Formats of textures whose size is not known: must stay empty. */
  readonly unknown = new Set<number>();
  private readonly buffers = new Map<WebGLBuffer, number>();
  private readonly textures = new Map<WebGLTexture, Map<number, number>>();
  private readonly gl: WebGL2RenderingContext;

  constructor(gl: WebGL2RenderingContext) {
    this.gl = gl;
    const own = gl as unknown as Record<string, Any>;
    const before = (name: string, act: (given: never[]) => void): void => {
      const real = own[name].bind(gl);
      own[name] = (...given: never[]) => {
        const result = real(...given);
        act(given);
        return result;
      };
    };
    for (const name of COUNT) {
      before(name, (given) => {
        const [count, instances] = COUNTED_AT[name].map((k) => (k < 0 ? 1 : Number(given[k])));
        this.drawn(given[0], [count], instances);
      });
    }
    const extension = gl.getExtension("WEBGL_multi_draw") as Record<string, Any> | null;
    if (extension) {
      const real = extension.multiDrawElementsWEBGL.bind(extension);
      extension.multiDrawElementsWEBGL = (...given: never[]) => {
        const [mode, counts, offset, , , , n] = given as unknown as [number, Int32Array, number, number, Int32Array, number, number];
        this.drawn(mode, counts.subarray(offset, offset + n), 1);
        return real(...given);
      };
    }
    this.countMemory(before);
  }

  get bytes(): number {
    let sum = 0;
    for (const size of this.buffers.values()) sum += size;
    for (const levels of this.textures.values()) for (const size of levels.values()) sum += size;
    return sum;
  }

  reset(): void {
    this.calls = this.parts = this.triangles = 0;
  }

  private drawn(mode: number, counts: ArrayLike<number>, instances: number): void {
    this.calls++;
    this.parts += counts.length;
    const { TRIANGLES, TRIANGLE_STRIP } = this.gl;
    for (let k = 0; k < counts.length; k++) {
      if (mode === TRIANGLES) this.triangles += Math.floor(counts[k] / 3) * instances;
      else if (mode === TRIANGLE_STRIP) this.triangles += Math.max(0, counts[k] - 2) * instances;
    }
  }

  private countMemory(before: (name: string, act: (given: never[]) => void) => void): void {
    const { gl } = this;
    const vertexArrays: Record<number, number> = {
      [gl.ARRAY_BUFFER]: gl.ARRAY_BUFFER_BINDING, [gl.ELEMENT_ARRAY_BUFFER]: gl.ELEMENT_ARRAY_BUFFER_BINDING,
      [gl.UNIFORM_BUFFER]: gl.UNIFORM_BUFFER_BINDING, [gl.PIXEL_UNPACK_BUFFER]: gl.PIXEL_UNPACK_BUFFER_BINDING,
    };
    const bound: Record<number, number> = {
      [gl.TEXTURE_2D]: gl.TEXTURE_BINDING_2D, [gl.TEXTURE_2D_ARRAY]: gl.TEXTURE_BINDING_2D_ARRAY, [gl.TEXTURE_3D]: gl.TEXTURE_BINDING_3D,
    };
    before("bufferData", (given) => {
      const [target, data] = given as unknown as [number, number | ArrayBufferView];
      const buffer = gl.getParameter(vertexArrays[target]) as WebGLBuffer | null;
      if (buffer) this.buffers.set(buffer, typeof data === "number" ? data : data.byteLength);
    });
    before("deleteBuffer", (given) => this.buffers.delete(given[0]));
    before("deleteTexture", (given) => this.textures.delete(given[0]));
    const texture = (target: number): Map<number, number> | null => {
      const cube = target >= gl.TEXTURE_CUBE_MAP_POSITIVE_X && target <= gl.TEXTURE_CUBE_MAP_NEGATIVE_Z;
      const handle = gl.getParameter(cube ? gl.TEXTURE_BINDING_CUBE_MAP : bound[target]) as WebGLTexture | null;
      if (!handle) return null;
      if (!this.textures.has(handle)) this.textures.set(handle, new Map());
      return this.textures.get(handle)!;
    };
    const storage = (target: number, levels: number, format: number, w: number, h: number, depth: number): void => {
      const sizes = texture(target);
      sizes?.clear();
      for (let k = 0; k < levels; k++) sizes?.set(k, this.size(format, Math.max(1, w >> k) * Math.max(1, h >> k) * depth));
    };
    before("texStorage2D", (given) => {
      const [target, levels, format, w, h] = given as unknown as number[];
      storage(target, levels, format, w, h, 1);
    });
    before("texStorage3D", (given) => {
      const [target, levels, format, w, h, depth] = given as unknown as number[];
      storage(target, levels, format, w, h, depth);
    });
    before("texImage2D", (given) => {
      const [target, level, format, w, h] = given as unknown as number[];
      const source = (given.length === 6 ? given[5] : null) as { width?: number; height?: number } | null;
      texture(target)?.set(level, this.size(format, source ? (source.width ?? 0) * (source.height ?? 0) : w * h));
    });
  }

  private size(format: number, texels: number): number {
    if (!(format in TEXEL_BYTES)) this.unknown.add(format);
    return (TEXEL_BYTES[format] ?? 4) * texels;
  }
}

/** Which arguments hold the count of vertices and of instances; -1: always one. */
const COUNTED_AT: Record<(typeof COUNT)[number], [number, number]> = {
  drawArrays: [2, -1], drawElements: [1, -1], drawArraysInstanced: [2, 3], drawElementsInstanced: [1, 4], drawRangeElements: [3, -1],
};
