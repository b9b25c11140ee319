/**
 * Draws objects whose geometry is not here as their boxes, in the mean colour of their surface: one draw call for all of them.
 * Only faces that look at the camera are drawn, so that a box that the camera stands in hides nothing.
 */
import { makeProgram, type Program } from "../gl/context";
import type { Vec3 } from "../placementdb/manifest";
import fragmentSource from "../shaders/boxes.fragment.glsl?raw";
import vertexSource from "../shaders/boxes.vertex.glsl?raw";
import type { DrawStats } from "./draw_impostor_layers";
import type { Lighting } from "./materials";
import type { View } from "./view";

const FLOATS = 7; // low, high, and four bytes of colour

export class Boxes {
  private readonly program: Program;
  private readonly array: WebGLVertexArrayObject;
  private readonly buffer: WebGLBuffer;
  private floats = new Float32Array(0);
  private bytes = new Uint8Array(0);

  constructor(private readonly gl: WebGL2RenderingContext, private readonly lighting: Lighting) {
    this.program = makeProgram(gl, vertexSource, fragmentSource);
    this.array = gl.createVertexArray()!;
    this.buffer = gl.createBuffer()!;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const [location, size, type, normalized, offset] of [[0, 3, gl.FLOAT, false, 0], [1, 3, gl.FLOAT, false, 12], [2, 3, gl.UNSIGNED_BYTE, true, 24]] as const) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, type, normalized, 4 * FLOATS, offset);
      gl.vertexAttribDivisor(location, 1);
    }
    gl.bindVertexArray(null);
  }

  /** The first n of `objects`; boxes are relative to `origin`. Sets all state that it needs in the current viewport. */
  draw(view: View, origin: Vec3, objects: Int32Array, n: number, boxes: Float64Array, colors: Uint8Array, stats: DrawStats): void {
    if (!n) return;
    const { gl, program, lighting } = this;
    if (this.floats.length < FLOATS * n) {
      this.floats = new Float32Array(2 * FLOATS * n);
      this.bytes = new Uint8Array(this.floats.buffer);
    }
    const { eye } = view.frame;
    for (let i = 0; i < n; i++) {
      const o = objects[i];
      for (let k = 0; k < 6; k++) this.floats[FLOATS * i + k] = boxes[6 * o + k] - (eye[k % 3] - origin[k % 3]);
      for (let k = 0; k < 3; k++) this.bytes[4 * FLOATS * i + 24 + k] = colors[3 * o + k];
    }
    gl.useProgram(program.handle);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.floats, gl.STREAM_DRAW, 0, FLOATS * n);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    gl.colorMask(true, true, true, true);
    gl.disable(gl.BLEND);
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.BACK);
    gl.frontFace(gl.CCW);
    gl.uniformMatrix4fv(program.uniform("u_view_projection"), false, view.viewProjection);
    gl.uniform3fv(program.uniform("u_sun_direction"), lighting.sun_direction);
    gl.uniform3fv(program.uniform("u_sun"), lighting.sun);
    gl.uniform3fv(program.uniform("u_sky"), lighting.sky);
    gl.uniform3fv(program.uniform("u_ground"), lighting.ground);
    gl.uniform1i(program.uniform("u_mode"), view.mode);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 36, n);
    gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(null);
    stats.calls++;
    stats.triangles += 12 * n;
  }
}
