/** The leaf cells of the view space as wire frames, the current one apart. */
import { makeProgram, type Program } from "../gl/context";
import fragmentSource from "../shaders/lines.fragment.glsl?raw";
import vertexSource from "../shaders/lines.vertex.glsl?raw";
import type { PlacementIndex } from "../placementdb/index_file";
import type { Vec3 } from "../placementdb/manifest";
import { boxLines } from "./box_lines";
import type { View } from "./view";

const MOST_CELLS = 20000;

export class CellLines {
  private readonly gl: WebGL2RenderingContext;
  readonly program: Program;
  private readonly array: WebGLVertexArrayObject;
  private readonly anchor: Vec3;
  private readonly count: number;

  constructor(gl: WebGL2RenderingContext, index: PlacementIndex) {
    this.gl = gl;
    this.program = makeProgram(gl, vertexSource, fragmentSource);
    const n = Math.min(MOST_CELLS, index.cellNode.length);
    const boxes = new Float64Array(6 * n);
    for (let c = 0; c < n; c++) boxes.set(index.nodeBox.subarray(6 * index.cellNode[c], 6 * index.cellNode[c] + 6), 6 * c);
    this.anchor = [index.nodeBox[0], index.nodeBox[1], index.nodeBox[2]];
    this.count = n;
    this.array = gl.createVertexArray()!;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, boxLines(boxes, this.anchor), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
    gl.bindVertexArray(null);
  }

  draw(view: View, origin: Vec3, current: number): void {
    const { gl, program, anchor } = this;
    const { eye } = view.frame;
    gl.useProgram(program.handle);
    gl.bindVertexArray(this.array);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(false);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.FUNC_ADD);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(program.uniform("u_view_projection"), false, view.viewProjection);
    gl.uniform3f(program.uniform("u_camera"), eye[0] - origin[0] - anchor[0], eye[1] - origin[1] - anchor[1], eye[2] - origin[2] - anchor[2]);
    gl.uniform4f(program.uniform("u_color"), 0, 0.38, 0.43, 0.55);
    gl.drawArrays(gl.LINES, 0, 24 * this.count);
    if (current >= 0 && current < this.count) {
      gl.disable(gl.DEPTH_TEST);
      gl.uniform4f(program.uniform("u_color"), 0.58, 0.32, 0, 1);
      gl.drawArrays(gl.LINES, 24 * current, 24);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }
}
