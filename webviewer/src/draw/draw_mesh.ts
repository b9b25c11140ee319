/**
 * The level's geometry through three.js, object by object as the selection says.
 *
 * three.js neither culls (it would by spheres and draw more than was counted) nor updates matrices: objects are static, and
 * the meshes that it is given are a pool that each frame fills anew. What is not here is drawn at another level of detail
 * that is, else left to the caller as a box: never a hole.
 */
import * as THREE from "three";
import type { GeometryIndex } from "../placementdb/geometry";
import type { Manifest } from "../placementdb/manifest";
import type { Selection } from "../select/select";
import type { DrawStats } from "./draw_impostor_layers";
import { LevelPages } from "./level_pages";
import { Materials, PagedMaterials, readLighting, type Lighting } from "./materials";
import type { View } from "./view";

export class LevelMesh {
  readonly renderer: THREE.WebGLRenderer;
  readonly lighting: Lighting;
  notice = "";
  /** Null where the level came whole, or has not begun to come. */
  pages: LevelPages | null = null;
  paged: PagedMaterials | null = null;
  geometry: GeometryIndex | null = null;
  /** Of the last frame: objects without any geometry here, for the caller to draw as boxes. */
  readonly absent: Int32Array;
  nAbsent = 0;
  /** Of the last frame: objects drawn as another of their levels or left out, and primitives without their texture. */
  missing = 0;
  untextured = 0;
  private readonly materials: Materials;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera();
  private readonly pool: THREE.Mesh[] = [];
  private readonly drawn: THREE.Object3D[] = [];
  private matrices: Float64Array = new Float64Array(0); // (N,16) column-major, to scene metres
  private models: (THREE.BufferGeometry[] | null)[] = [];
  private objectMesh: Int32Array = new Int32Array(0);
  private meshModel: Int32Array = new Int32Array(0);
  /** Of a level that came whole: meshes of each object, and geometries of each object, level and mesh. */
  meshes: THREE.Mesh[][] = [];
  geometries: THREE.BufferGeometry[][][] = [];

  constructor(canvas: HTMLCanvasElement, gl: WebGL2RenderingContext, manifest: Manifest) {
    this.renderer = new THREE.WebGLRenderer({ canvas, context: gl, antialias: false, alpha: false });
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // the target encodes
    this.scene.matrixWorldAutoUpdate = false;
    this.scene.children = this.drawn; // filled anew every frame; parents are never asked
    this.camera.matrixAutoUpdate = false;
    this.camera.matrixWorldAutoUpdate = false;
    this.lighting = readLighting(manifest.lighting);
    this.materials = new Materials(this.lighting);
    this.absent = new Int32Array(manifest.counts.objects);
  }

  get ready(): boolean {
    return this.objectMesh.length > 0;
  }

  /** Opens a level in pages, of which none is here yet; shaders are compiled now, not in a frame. */
  open(manifest: Manifest, index: GeometryIndex, capBytes: number): void {
    const n = index.objectMesh.length;
    this.matrices = new Float64Array(16 * n);
    for (let o = 0; o < n; o++) {
      for (let row = 0; row < 3; row++) for (let c = 0; c < 4; c++) this.matrices[16 * o + 4 * c + row] = index.objectMatrix[12 * o + 4 * row + c];
      for (let a = 0; a < 3; a++) this.matrices[16 * o + 12 + a] += manifest.origin_m[a];
      this.matrices[16 * o + 15] = 1;
    }
    this.geometry = index;
    this.paged = new PagedMaterials(index, this.materials);
    this.pages = new LevelPages(manifest.geometry!, index, this.paged, capBytes);
    this.models = this.pages.models;
    this.objectMesh = index.objectMesh;
    this.meshModel = index.meshModel;
    this.notice = manifest.geometry!.notice ?? "";
    this.compile();
  }

  /** Takes the whole level from a GLB, for placements that have it nowhere else. */
  async load(glb: ArrayBuffer, n: number, levelRow: Int32Array): Promise<void> {
    const { readGlb } = await import("./read_glb");
    const whole = await readGlb(glb, n, levelRow, this.materials);
    this.notice = whole.notice;
    this.matrices = whole.matrices;
    this.objectMesh = Int32Array.from({ length: n }, (_, o) => o);
    this.meshes = whole.meshes;
    this.geometries = whole.geometries;
  }

  /** Draws the selected objects into the current viewport and scissor of the renderer. */
  draw(view: View, { objects, nObjects: n, levels }: Selection, stats: DrawStats): void {
    this.setCamera(view);
    this.materials.mode.value = view.mode;
    this.nAbsent = this.missing = this.untextured = 0;
    let k = 0;
    for (let i = 0; i < n; i++) {
      const o = objects[i];
      const mesh = this.objectMesh[o];
      const parts = this.paged ? (this.models[this.meshModel[mesh] + levels[o]] ?? this.standIn(mesh, levels[o])) : this.geometries[o][levels[o]];
      if (!parts) {
        this.absent[this.nAbsent++] = o;
        continue;
      }
      for (let j = 0; j < parts.length; j++) {
        const drawn = this.pool[k] ?? this.grow();
        drawn.geometry = parts[j];
        drawn.material = this.materialOf(mesh, j, parts[j]);
        const { elements } = drawn.matrixWorld;
        for (let q = 0; q < 16; q++) elements[q] = this.matrices[16 * o + q];
        this.drawn[k++] = drawn;
      }
    }
    this.drawn.length = k;
    this.renderer.info.reset();
    this.renderer.render(this.scene, this.camera);
    stats.calls += this.renderer.info.render.calls;
    stats.triangles += this.renderer.info.render.triangles;
  }

  /** Another level of the mesh that is here, finer ones first; null: none is. */
  private standIn(mesh: number, level: number): THREE.BufferGeometry[] | null {
    this.missing++;
    const first = this.meshModel[mesh];
    for (let l = level - 1; l >= 0; l--) if (this.models[first + l]) return this.models[first + l];
    for (let q = first + level + 1; q < this.meshModel[mesh + 1]; q++) if (this.models[q]) return this.models[q];
    return null;
  }

  private materialOf(mesh: number, part: number, geometry: THREE.BufferGeometry): THREE.Material {
    if (!this.paged) return this.meshes[mesh][part].material as THREE.Material;
    const { meshPrimitive, primitiveMaterial } = this.geometry!;
    const at = 2 * primitiveMaterial[meshPrimitive[mesh] + part] + (geometry.attributes.color ? 1 : 0);
    if (this.paged.pending[at]) this.untextured++;
    return this.paged.all[at];
  }

  private grow(): THREE.Mesh {
    const mesh = new THREE.Mesh();
    mesh.frustumCulled = false;
    mesh.matrixAutoUpdate = false;
    mesh.matrixWorldAutoUpdate = false;
    this.pool.push(mesh);
    return mesh;
  }

  private compile(): void {
    const corner = new THREE.BufferGeometry();
    for (const name of ["position", "normal"]) corner.setAttribute(name, new THREE.BufferAttribute(new Float32Array(9), 3));
    corner.setAttribute("uv", new THREE.BufferAttribute(new Float32Array(6), 2));
    const meshes = this.paged!.all.filter((_, k) => k % 2 === 0).map((material) => new THREE.Mesh(corner, material));
    const scene = new THREE.Scene();
    scene.children = meshes;
    this.renderer.compile(scene, this.camera);
    corner.dispose();
  }

  private setCamera(view: View): void {
    const { frame, near, far, tanX, tanY } = view;
    const { eye, right: r, up: u, forward: f } = frame;
    this.camera.matrixWorld.set(r[0], u[0], -f[0], eye[0], r[1], u[1], -f[1], eye[1], r[2], u[2], -f[2], eye[2], 0, 0, 0, 1);
    this.camera.matrixWorldInverse.copy(this.camera.matrixWorld).invert();
    this.camera.projectionMatrix.makePerspective(-near * tanX, near * tanX, near * tanY, -near * tanY, near, far);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
  }
}
