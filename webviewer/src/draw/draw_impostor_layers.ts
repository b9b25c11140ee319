/**
 * Draws all impostor layers of a frame in one draw call: one vertex buffer, one texture array, no state per impostor.
 *
 * State in, draw calls out: which triangles to draw is an index buffer that changes only when the impostor list or what is
 * resident does. The GPU state touched here is set in full and reset by three.js afterwards.
 */
import { makeProgram, type Program } from "../gl/context";
import type { ChunkBuffers } from "../gl/chunk_buffers";
import type { PageArray } from "../gl/page_array";
import fragmentSource from "../shaders/impostor_layers.fragment.glsl?raw";
import vertexSource from "../shaders/impostor_layers.vertex.glsl?raw";
import type { Vec3 } from "../placementdb/manifest";
import { IDS, type View } from "./view";

export interface DrawStats {
  calls: number;
  triangles: number;
}

// .L0 to .L3 of the mock-ups: petrol, ochre, light petrol, dark ochre.
const TINTS = new Float32Array([0x2c, 0x7f, 0x85, 0xd2, 0x9c, 0x4d, 0x78, 0xb5, 0xb5, 0x8a, 0x4b, 0x00].map((x) => x / 255));

export class ImpostorLayers {
  readonly indexBuffer: WebGLBuffer;
  /** Linear colours of the seven classes of texels a pixel. */
  readonly heat = new Float32Array(21);
  private readonly gl: WebGL2RenderingContext;
  private readonly program: Program;
  /** Whether the shader says itself which samples of a pixel it covers. */
  private readonly masks: boolean;
  private indices = new Uint32Array(3 * 1024);
  private capacity = 0;
  private count = 0;
  private chunk: ChunkBuffers | null = null;

  constructor(gl: WebGL2RenderingContext) {
    this.gl = gl;
    this.masks = gl.getExtension("OES_sample_variables") !== null;
    const version = "#version 300 es\n";
    const masking = `${version}#extension GL_OES_sample_variables : require\n#define SAMPLE_MASK\n`;
    this.program = makeProgram(gl, vertexSource, this.masks ? fragmentSource.replace(version, masking) : fragmentSource);
    this.indexBuffer = gl.createBuffer()!;
  }

  /** Says which local impostors of the chunk to draw from now on. */
  setShown(chunk: ChunkBuffers | null, shown: readonly number[]): void {
    const { gl } = this;
    this.chunk = chunk;
    this.count = 0;
    if (!chunk) return;
    let n = 0;
    for (const m of shown) n += 3 * (chunk.triangleRow[m + 1] - chunk.triangleRow[m]);
    if (n > this.indices.length) this.indices = new Uint32Array(2 * n);
    for (const m of shown) {
      const part = chunk.triangles.subarray(3 * chunk.triangleRow[m], 3 * chunk.triangleRow[m + 1]);
      this.indices.set(part, this.count);
      this.count += part.length;
    }
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indexBuffer);
    if (n > this.capacity) {
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.indices, gl.DYNAMIC_DRAW);
      this.capacity = this.indices.length;
    } else {
      gl.bufferSubData(gl.ELEMENT_ARRAY_BUFFER, 0, this.indices, 0, n);
    }
  }

  /** Draws into the current viewport and scissor; origin is the placement's origin_m. */
  draw(view: View, pages: PageArray, origin: Vec3, stats: DrawStats): void {
    const { gl, chunk, program } = this;
    if (!chunk || !this.count) return;
    gl.useProgram(program.handle);
    gl.bindVertexArray(chunk.array);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    gl.colorMask(true, true, true, true);
    gl.disable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    bindTexture(gl, 0, gl.TEXTURE_2D, chunk.rowTexture);
    bindTexture(gl, 1, gl.TEXTURE_2D, pages.slotTexture);
    bindTexture(gl, 2, gl.TEXTURE_2D_ARRAY, pages.texture);
    gl.uniform1i(program.uniform("u_rows"), 0);
    gl.uniform1i(program.uniform("u_slots"), 1);
    gl.uniform1i(program.uniform("u_pages"), 2);
    gl.uniformMatrix4fv(program.uniform("u_view_projection"), false, view.viewProjection);
    const { near, far, frame: { eye, forward } } = view;
    const { anchor } = chunk;
    gl.uniform3f(program.uniform("u_camera"), eye[0] - origin[0] - anchor[0], eye[1] - origin[1] - anchor[1], eye[2] - origin[2] - anchor[2]);
    gl.uniform3f(program.uniform("u_forward"), forward[0], forward[1], forward[2]);
    // Depth in [0,1] of a point at distance z along forward is x + y / z.
    gl.uniform2f(program.uniform("u_depth"), far / (far - near), (-far * near) / (far - near));
    gl.uniform1i(program.uniform("u_mode"), view.mode);
    gl.uniform3fv(program.uniform("u_tints"), TINTS);
    gl.uniform3fv(program.uniform("u_heat"), this.heat);
    if (view.mode !== IDS && !this.masks) gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.bindVertexArray(null);
    stats.calls += 1;
    stats.triangles += this.count / 3;
  }
}

function bindTexture(gl: WebGL2RenderingContext, unit: number, target: number, texture: WebGLTexture): void {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, texture);
  gl.bindSampler(unit, null);
}
