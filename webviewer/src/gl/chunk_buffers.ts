/**
 * A chunk's layers in video memory: one vertex buffer, one table of rows, and per impostor its range of triangles.
 *
 * Positions are relative to the impostor's eye (float32, as stored); eyes are relative to the chunk's anchor, the middle of
 * its box: with float64 subtraction on this side, 1 km keeps a tenth of a millimetre.
 */
import type { PlacementChunk } from "../placementdb/chunk";
import type { Vec3 } from "../placementdb/manifest";

export const ROWS_WIDTH = 256; // rows of the layer table side by side in the texture, four texels each

export interface ChunkArrays {
  vertices: ArrayBuffer; // 24 bytes each: position 3 x f32, uv 2 x f32, row u32
  triangles: Uint32Array; // three vertices each
  triangleRow: Int32Array; // (M+1) triangles of local impostor m
  rows: Float32Array; // (height, ROWS_WIDTH, 4, 4)
  height: number;
}

/** Lays a chunk out for the GPU; `anchor` is relative to origin_m. Pure. */
export function layOut(chunk: PlacementChunk, anchor: Vec3): ChunkArrays {
  const M = chunk.impostorId.length;
  const R = chunk.layerNumber.length;
  const Q = chunk.cornerUv.length / 2;
  const vertices = new ArrayBuffer(24 * Q);
  const f32 = new Float32Array(vertices);
  const u32 = new Uint32Array(vertices);
  const height = Math.max(1, Math.ceil(R / ROWS_WIDTH));
  const rows = new Float32Array(height * ROWS_WIDTH * 16);
  const triangles = new Uint32Array(3 * Math.max(0, Q - 2 * R));
  const triangleRow = new Int32Array(M + 1);
  let t = 0;
  for (let m = 0; m < M; m++) {
    for (let r = chunk.impostorLayer[m]; r < chunk.impostorLayer[m + 1]; r++) {
      for (let a = 0; a < 3; a++) rows[16 * r + a] = chunk.impostorEye[3 * m + a] - anchor[a];
      rows[16 * r + 3] = chunk.layerPlane[r];
      rows[16 * r + 4] = chunk.layerInverseNear[r];
      rows[16 * r + 5] = chunk.layerInverseFar[r];
      rows[16 * r + 6] = chunk.layerPage[r];
      rows[16 * r + 7] = chunk.layerNumber[r];
      for (let k = 0; k < 4; k++) rows[16 * r + 8 + k] = chunk.layerRect[4 * r + k];
      rows[16 * r + 12] = chunk.impostorId[m] + 1;
      const first = chunk.layerCorner[r];
      const stop = chunk.layerCorner[r + 1];
      for (let c = first; c < stop; c++) {
        for (let a = 0; a < 3; a++) f32[6 * c + a] = chunk.cornerPosition[3 * c + a];
        f32[6 * c + 3] = chunk.cornerUv[2 * c];
        f32[6 * c + 4] = chunk.cornerUv[2 * c + 1];
        u32[6 * c + 5] = r;
      }
      for (let c = first + 1; c + 1 < stop; c++) {
        triangles.set([first, c, c + 1], 3 * t);
        t++;
      }
    }
    triangleRow[m + 1] = t;
  }
  return { vertices, triangles, triangleRow, rows, height };
}

export class ChunkBuffers {
  readonly anchor: Vec3;
  readonly triangles: Uint32Array;
  readonly triangleRow: Int32Array;
  readonly array: WebGLVertexArrayObject;
  readonly rowTexture: WebGLTexture;
  readonly bytes: number;
  private readonly vertexBuffer: WebGLBuffer;
  private readonly gl: WebGL2RenderingContext;

  constructor(gl: WebGL2RenderingContext, chunk: PlacementChunk, anchor: Vec3, indexBuffer: WebGLBuffer) {
    this.gl = gl;
    this.anchor = anchor;
    const arrays = layOut(chunk, anchor);
    this.triangles = arrays.triangles;
    this.triangleRow = arrays.triangleRow;
    this.bytes = arrays.vertices.byteLength + arrays.rows.byteLength;
    this.array = gl.createVertexArray()!;
    this.vertexBuffer = gl.createBuffer()!;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.vertexBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, arrays.vertices, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 24, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 24, 12);
    gl.enableVertexAttribArray(2);
    gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_INT, 24, 20);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indexBuffer);
    gl.bindVertexArray(null);
    this.rowTexture = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, this.rowTexture);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 4 * ROWS_WIDTH, arrays.height, 0, gl.RGBA, gl.FLOAT, arrays.rows);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  }

  dispose(): void {
    this.gl.deleteVertexArray(this.array);
    this.gl.deleteBuffer(this.vertexBuffer);
    this.gl.deleteTexture(this.rowTexture);
  }
}
