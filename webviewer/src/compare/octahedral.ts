/**
 * Octahedral impostors, one an object: an atlas of N x N views from the upper half of an octahedron, blended between the three nearest.
 *
 * Problem  What a practitioner would do for far objects without any placement: one picture set an object, whatever the view space.
 * Method   Per object colour and coverage (4 samples, lit as the level is, whose light stands still), orthographic, framed by the bounding
 *          sphere; mip levels. An object is shown so once its sphere's picture is at most SHARP times a frame wide; all of them are
 *          squares in one instanced call. Sizes: the first of SIZES whose atlases fit into MOST_BYTES, as for a desktop GPU.
 *          Objects with blended materials stay geometry: a blended picture cannot be told from a hole.
 * After    Brucks. Octahedral Impostors (2018), and the open implementations for three.js and Godot that follow it: the grid, the
 *          three frames with barycentric weights, a virtual plane through the centre for each.
 */
import * as THREE from "three";
import { makeProgram, type Program } from "../gl/context";
import type { Vec3 } from "../placementdb/manifest";
import type { Selection } from "../select/select";
import bakeSource from "./octahedral_bake.vertex.glsl?raw";
import fragmentSource from "./octahedral.fragment.glsl?raw";
import framesSource from "./octahedral_frames.glsl?raw";
import { MESH_SHADERS, withSurface } from "../shaders/surface";
import vertexSource from "./octahedral.vertex.glsl?raw";
import { here, type Given, type Way } from "./way";

const SIZES = [[8, 64], [8, 32], [6, 32], [8, 16], [6, 16]] as const; // frames along an edge, texels a frame
const MOST_BYTES = 768 * 2 ** 20;
const PAGE = 2048; // texels
const SHARP = 2; // pixels that a texel may cover, along an edge
const LEVELS = 4;
const TABLE_WIDTH = 1024;

export async function octahedralWay({ whole, placement, frame }: Given): Promise<Way> {
  const { gl } = frame;
  const level = await whole();
  const { index } = placement;
  const spheres = level.meshes.map((_, o) => sphereOf(index.objectBox.subarray(6 * o, 6 * o + 6)));
  const able = level.meshes.map((list, o) => spheres[o].radius > 0 && list.every((m) => !(m.material as THREE.Material).transparent));
  const wanted = able.filter(Boolean).length;
  const layout = layoutFor(wanted, gl);
  const table = new Float32Array(4 * TABLE_WIDTH * Math.ceil((2 * Math.max(1, able.length)) / TABLE_WIDTH));
  const tiles: { object: number; layer: number; x: number; y: number }[] = [];
  able.forEach((is, o) => {
    if (!is) return;
    const at = tiles.length % layout.perPage;
    const tile = { object: o, layer: Math.floor(tiles.length / layout.perPage), x: (at % layout.perRow) * layout.tile, y: Math.floor(at / layout.perRow) * layout.tile };
    tiles.push(tile);
    table.set([...spheres[o].centre, spheres[o].radius, tile.x, tile.y, tile.layer, 0], 8 * o);
  });
  const bake = new Bake(frame.gl, level.renderer, layout, placement.manifest.origin_m);
  for (const { object, layer, x, y } of tiles) bake.object(level.meshes[object], spheres[object], layer, x, y);
  const squares = new Squares(gl, layout, table, bake.finish());
  const drawn = { calls: 0, triangles: 0 };
  const { height } = placement.manifest.camera;
  const far = new Float32Array(able.length);
  return {
    claimed: drawn,
    preparedBytes: 0,
    said: `${layout.side} x ${layout.side} views of ${layout.frame} texels for ${wanted} objects`,
    settle: here,
    draw: (position: Vec3, direction: Vec3) => {
      const selection: Selection = frame.begin(position, direction);
      const eye = position.map((x, a) => x - placement.manifest.origin_m[a]) as Vec3;
      const focal = height / (2 * frame.view.tanY);
      let near = 0;
      let n = 0;
      for (let i = 0; i < selection.nObjects; i++) {
        const o = selection.objects[i];
        const { centre, radius } = spheres[o];
        const distance = Math.hypot(centre[0] - eye[0], centre[1] - eye[1], centre[2] - eye[2]);
        if (able[o] && distance > 2 * radius && (2 * radius * focal) / distance <= SHARP * layout.frame) far[n++] = o;
        else selection.objects[near++] = o;
      }
      drawn.calls = drawn.triangles = 0;
      squares.draw(frame.view.viewProjection, eye, focal, far.subarray(0, n), drawn);
      level.draw(frame, selection.objects, near, drawn);
      frame.end();
    },
  };
}

interface Sphere {
  centre: Vec3; // relative to origin_m
  radius: number;
}

interface Layout {
  side: number;
  frame: number;
  tile: number;
  perRow: number;
  perPage: number;
  pages: number;
}

function sphereOf(box: Float64Array): Sphere {
  const centre = [0, 1, 2].map((a) => (box[a] + box[3 + a]) / 2) as Vec3;
  return { centre, radius: Math.hypot(box[3] - box[0], box[4] - box[1], box[5] - box[2]) / 2 };
}

function layoutFor(objects: number, gl: WebGL2RenderingContext): Layout {
  const most = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS) as number;
  const made = SIZES.map(([side, frame]) => {
    const perRow = Math.floor(PAGE / (side * frame));
    return { side, frame, tile: side * frame, perRow, perPage: perRow ** 2, pages: Math.max(1, Math.ceil(objects / perRow ** 2)) };
  });
  return made.find(({ pages }) => pages <= most && pages * PAGE ** 2 * 4 <= MOST_BYTES) ?? made[made.length - 1];
}

/** Draws atlases page by page with the level's own materials. */
class Bake {
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.OrthographicCamera();
  private readonly materials = new Map<THREE.Material, THREE.ShaderMaterial>();
  private readonly geometries = new Map<THREE.BufferGeometry, THREE.InstancedBufferGeometry>();
  private readonly texture: WebGLTexture;
  private readonly drawn: WebGLFramebuffer;
  private readonly averaged: WebGLFramebuffer;
  private readonly stores: WebGLRenderbuffer[];
  private page = -1;
  private readonly uniforms: { u_centre: { value: THREE.Vector3 }; u_radius: { value: number }; u_side: { value: number }; u_inner: { value: number } };

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly renderer: THREE.WebGLRenderer,
    private readonly layout: Layout,
    private readonly origin: Vec3,
  ) {
    this.scene.matrixWorldAutoUpdate = false;
    this.uniforms = { u_centre: { value: new THREE.Vector3() }, u_radius: { value: 1 }, u_side: { value: layout.side }, u_inner: { value: innerOf(layout) } };
    this.texture = gl.createTexture()!;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, LEVELS, gl.SRGB8_ALPHA8, PAGE, PAGE, layout.pages);
    this.drawn = gl.createFramebuffer()!;
    this.averaged = gl.createFramebuffer()!;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.drawn);
    this.stores = ([[gl.SRGB8_ALPHA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]] as const).map(([format, where]) => {
      const store = gl.createRenderbuffer()!;
      gl.bindRenderbuffer(gl.RENDERBUFFER, store);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, Math.min(4, gl.getParameter(gl.MAX_SAMPLES) as number), format, PAGE, PAGE);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, where, gl.RENDERBUFFER, store);
      return store;
    });
  }

  object(meshes: THREE.Mesh[], { centre, radius }: Sphere, page: number, x: number, y: number): void {
    const { gl, layout, uniforms, renderer } = this;
    if (page !== this.page) this.next(page);
    uniforms.u_centre.value.set(centre[0] + this.origin[0], centre[1] + this.origin[1], centre[2] + this.origin[2]);
    uniforms.u_radius.value = radius;
    this.scene.children = meshes.map((mesh) => this.baked(mesh));
    renderer.setViewport(x, y, layout.tile, layout.tile);
    renderer.render(this.scene, this.camera);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.drawn);
  }

  /** The texture array, with its mip levels. */
  finish(): WebGLTexture {
    const { gl } = this;
    if (this.page >= 0) this.keep();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.generateMipmap(gl.TEXTURE_2D_ARRAY);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAX_LEVEL, LEVELS - 1);
    for (const store of this.stores) gl.deleteRenderbuffer(store);
    gl.deleteFramebuffer(this.drawn);
    gl.deleteFramebuffer(this.averaged);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return this.texture;
  }

  private next(page: number): void {
    const { gl, renderer } = this;
    if (this.page >= 0) this.keep();
    this.page = page;
    renderer.resetState();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.drawn);
    renderer.setScissorTest(false);
    gl.colorMask(true, true, true, true);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    gl.clearDepth(1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  private keep(): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.drawn);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, this.averaged);
    gl.framebufferTextureLayer(gl.DRAW_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, this.texture, 0, this.page);
    gl.blitFramebuffer(0, 0, PAGE, PAGE, 0, 0, PAGE, PAGE, gl.COLOR_BUFFER_BIT, gl.NEAREST);
  }

  private baked(mesh: THREE.Mesh): THREE.Mesh {
    const source = mesh.material as THREE.ShaderMaterial;
    let material = this.materials.get(source);
    if (!material) {
      material = source.clone();
      material.vertexShader = withSurface(bakeSource).replace("FRAMES", framesSource);
      material.fragmentShader = MESH_SHADERS.fragmentShader;
      Object.assign(material.uniforms, this.uniforms); // shared, not cloned
      this.materials.set(source, material);
    }
    let geometry = this.geometries.get(mesh.geometry);
    if (!geometry) {
      geometry = new THREE.InstancedBufferGeometry();
      geometry.index = mesh.geometry.index;
      for (const [name, attribute] of Object.entries(mesh.geometry.attributes)) geometry.setAttribute(name, attribute);
      geometry.instanceCount = this.layout.side ** 2;
      this.geometries.set(mesh.geometry, geometry);
    }
    const made = new THREE.Mesh(geometry, material);
    made.frustumCulled = made.matrixAutoUpdate = made.matrixWorldAutoUpdate = false;
    made.matrixWorld.copy(mesh.matrixWorld);
    return made;
  }
}

/** Half a texel on each side of a frame stays empty, so that filtering does not reach its neighbour. */
const innerOf = ({ frame }: Layout): number => (frame - 1) / frame;

/** The far objects of a frame, in one call. */
class Squares {
  private readonly program: Program;
  private readonly array: WebGLVertexArrayObject;
  private readonly objects: WebGLBuffer;
  private readonly table: WebGLTexture;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly layout: Layout,
    table: Float32Array,
    private readonly atlas: WebGLTexture,
  ) {
    this.program = makeProgram(gl, vertexSource.replace("FRAMES", framesSource), fragmentSource.replace("FRAMES", framesSource));
    this.table = gl.createTexture()!;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, TABLE_WIDTH, table.length / 4 / TABLE_WIDTH);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TABLE_WIDTH, table.length / 4 / TABLE_WIDTH, gl.RGBA, gl.FLOAT, table);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.array = gl.createVertexArray()!;
    this.objects = gl.createBuffer()!;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.objects);
    gl.bufferData(gl.ARRAY_BUFFER, Math.max(4, table.length / 2), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 1, gl.FLOAT, false, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.bindVertexArray(null);
  }

  draw(viewProjection: Float32Array, eye: Vec3, focal: number, objects: Float32Array, drawn: { calls: number; triangles: number }): void {
    const { gl, program, layout } = this;
    if (!objects.length) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.objects);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, objects);
    gl.useProgram(program.handle);
    gl.bindVertexArray(this.array);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    ([[this.table, gl.TEXTURE_2D], [this.atlas, gl.TEXTURE_2D_ARRAY]] as const).forEach(([texture, target], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.bindSampler(unit, null);
    });
    gl.uniform1i(program.uniform("u_table"), 0);
    gl.uniform1i(program.uniform("u_atlas"), 1);
    gl.uniformMatrix4fv(program.uniform("u_view_projection"), false, viewProjection);
    gl.uniform3f(program.uniform("u_eye"), eye[0], eye[1], eye[2]);
    gl.uniform1f(program.uniform("u_side"), layout.side);
    gl.uniform1f(program.uniform("u_frame"), layout.frame);
    gl.uniform1f(program.uniform("u_inner"), innerOf(layout));
    gl.uniform1f(program.uniform("u_focal"), focal);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, objects.length);
    gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.bindVertexArray(null);
    drawn.calls += 1;
    drawn.triangles += 2 * objects.length;
  }
}
