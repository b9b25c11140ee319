/** A few wire frames that are looked at one by one, seen through everything: see wires.ts. */
import type { Program } from "../gl/context";
import type { Vec3 } from "../placementdb/manifest";
import type { View } from "./view";
import type { Wires } from "./wires";

export class WireLines {
  private readonly array: WebGLVertexArrayObject;
  private readonly buffer: WebGLBuffer;
  private anchor: Vec3 = [0, 0, 0];
  private count = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly program: Program, // of lines
    private readonly color: readonly [number, number, number, number],
  ) {
    this.array = gl.createVertexArray()!;
    this.buffer = gl.createBuffer()!;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
    gl.bindVertexArray(null);
  }

  /** What to draw from now on; null: nothing. */
  set(wires: Wires | null): void {
    const { gl } = this;
    this.count = wires ? wires.ends.length / 3 : 0;
    if (!wires) return;
    this.anchor = wires.anchor;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, wires.ends, gl.DYNAMIC_DRAW);
  }

  draw(view: View, origin: Vec3): void {
    const { gl, program, anchor, color } = this;
    if (!this.count) return;
    const { eye } = view.frame;
    gl.useProgram(program.handle);
    gl.bindVertexArray(this.array);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.uniformMatrix4fv(program.uniform("u_view_projection"), false, view.viewProjection);
    gl.uniform3f(program.uniform("u_camera"), eye[0] - origin[0] - anchor[0], eye[1] - origin[1] - anchor[1], eye[2] - origin[2] - anchor[2]);
    gl.uniform4f(program.uniform("u_color"), color[0], color[1], color[2], color[3]);
    gl.drawArrays(gl.LINES, 0, this.count);
    gl.bindVertexArray(null);
  }
}
