/** Meshes for controlled frames: grids that face the camera, drawn by three.js with the shader of the level, back to front. */
import * as THREE from "three";
import { MESH_SHADERS } from "../shaders/surface";
import type { View } from "../draw/view";
import { SIDES, halton, meshesFor, rectangle, type Load } from "./plan";

const TEXTURES = 8; // a level changes materials between objects
const NEAREST_M = 10;
const FARTHEST_M = 100;

export class Objects {
  readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera();
  private readonly pool: THREE.Mesh[] = [];
  private readonly geometries = SIDES.map(grid);
  private readonly materials = Array.from({ length: TEXTURES }, (_, k) => material(k));

  constructor(canvas: HTMLCanvasElement, gl: WebGL2RenderingContext) {
    this.renderer = new THREE.WebGLRenderer({ canvas, context: gl, antialias: false, alpha: false });
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.scene.matrixWorldAutoUpdate = false;
    this.camera.matrixAutoUpdate = this.camera.matrixWorldAutoUpdate = false;
  }

  /** Lays the meshes of a frame out; returns what they come to: pixels are those of their rectangles. */
  prepare(load: Load, view: View, width: number, height: number): { calls: number; triangles: number; pixels: number } {
    const sides = meshesFor(load.calls, load.triangles);
    const [wide, high] = rectangle(load.calls ? load.pixels / load.calls : 1, width, height);
    this.scene.children = [];
    let triangles = 0;
    let k = 0;
    SIDES.forEach((side, size) => {
      for (let n = 0; n < sides[size]; n++, k++) {
        const mesh = (this.pool[k] ??= blank());
        mesh.geometry = this.geometries[size];
        mesh.material = this.materials[k % TEXTURES];
        mesh.renderOrder = k; // back to front: every pixel of every mesh is shaded
        const far = FARTHEST_M - ((FARTHEST_M - NEAREST_M) * k) / Math.max(1, load.calls);
        const unit = (2 * far * view.tanY) / height; // metres a pixel
        const x = (halton(k + 1, 2) - 0.5) * (width - wide) * unit;
        const y = (halton(k + 1, 3) - 0.5) * (height - high) * unit;
        mesh.matrixWorld.set(wide * unit, 0, 0, x, 0, high * unit, 0, y, 0, 0, 1, -far, 0, 0, 0, 1);
        this.scene.children.push(mesh);
        triangles += 2 * side * side;
      }
    });
    this.camera.projectionMatrix.makePerspective(-view.near * view.tanX, view.near * view.tanX, view.near * view.tanY, -view.near * view.tanY, view.near, view.far);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
    return { calls: k, triangles, pixels: Math.round(k * wide * high) };
  }

  draw(): void {
    this.renderer.info.reset();
    this.renderer.render(this.scene, this.camera);
  }

  dispose(): void {
    for (const geometry of this.geometries) geometry.dispose();
    for (const one of this.materials) one.dispose();
    this.renderer.dispose();
  }
}

function blank(): THREE.Mesh {
  const mesh = new THREE.Mesh();
  mesh.frustumCulled = mesh.matrixAutoUpdate = mesh.matrixWorldAutoUpdate = false;
  return mesh;
}

/** A unit square about the origin in the plane z = 0, as a grid. */
function grid(side: number): THREE.BufferGeometry {
  return new THREE.PlaneGeometry(1, 1, side, side);
}

function material(k: number): THREE.ShaderMaterial {
  const size = 256;
  const texels = new Uint8Array(4 * size * size);
  for (let i = 0; i < texels.length; i++) texels[i] = i % 4 === 3 ? 255 : 60 + 20 * k + (((i >> 5) ^ (i >> 13)) & 1) * 40;
  const map = new THREE.DataTexture(texels, size, size);
  map.colorSpace = THREE.SRGBColorSpace;
  map.generateMipmaps = true;
  map.minFilter = THREE.LinearMipmapLinearFilter;
  map.magFilter = THREE.LinearFilter;
  map.needsUpdate = true;
  const vector = (...v: [number, number, number]): THREE.IUniform => ({ value: new THREE.Vector3(...v) });
  return new THREE.ShaderMaterial({
    glslVersion: THREE.GLSL3, ...MESH_SHADERS, defines: { TEXTURED: "" }, toneMapped: false,
    uniforms: {
      u_mode: { value: 0 }, u_sun_direction: vector(0.48, 0.64, 0.6), u_sun: vector(0.74, 0.7, 0.62), u_sky: vector(0.5, 0.56, 0.66), u_ground: vector(0.24, 0.22, 0.2),
      u_base: { value: new THREE.Vector4(1, 1, 1, 1) }, u_emissive: vector(0, 0, 0), u_cutoff: { value: 0 }, u_map: { value: map }, u_glow: { value: null },
      u_uv_transform: { value: new THREE.Matrix3() },
    },
  });
}
