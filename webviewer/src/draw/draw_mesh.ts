/**
 * The level's geometry: `scene.glb` through three.js, one mesh per primitive, drawn object by object as the selection says.
 *
 * three.js neither culls (it would by spheres and draw more than was counted) nor updates matrices: objects are static.
 * A level of detail is another geometry on the same vertices: an object's meshes take the one of the level they are drawn at.
 */
import * as THREE from "three";
import { GLTFLoader, type GLTF } from "three/addons/loaders/GLTFLoader.js";
import fragmentSource from "../shaders/mesh.fragment.glsl?raw";
import vertexSource from "../shaders/mesh.vertex.glsl?raw";
import type { DrawStats } from "./draw_impostor_layers";
import type { Selection } from "../select/select";
import type { View } from "./view";

export type Lighting = Record<"sun_direction" | "sun" | "sky" | "ground", [number, number, number]>;

// LIGHTING of services/farfield/bake/shade.py, for a placement that states none.
const DEFAULT_LIGHTING: Lighting = {
  sun_direction: [0.48, 0.64, 0.6], sun: [0.74, 0.7, 0.62], sky: [0.5, 0.56, 0.66], ground: [0.24, 0.22, 0.2],
};

export function readLighting(stated: Record<string, unknown> | null): Lighting {
  const known = Object.keys(DEFAULT_LIGHTING).every((key) => {
    const value = stated?.[key];
    return Array.isArray(value) && value.length === 3 && value.every((x) => Number.isFinite(x));
  });
  return known ? (stated as Lighting) : DEFAULT_LIGHTING;
}

/** Geometries of each object, level and mesh: `extras.levels` of a glTF mesh names the meshes that are its levels. */
async function readLevels(gltf: GLTF, meshes: THREE.Mesh[][]): Promise<THREE.BufferGeometry[][][]> {
  const { parser } = gltf;
  const definitions = parser.json.meshes as { extras?: { levels?: number[] } }[];
  const known = new Map<number, Promise<THREE.BufferGeometry[][]>>();
  const levelsOf = async (mesh: number): Promise<THREE.BufferGeometry[][]> => {
    const levels = definitions[mesh]?.extras?.levels ?? [];
    return Promise.all(levels.map(async (level) => geometriesOf((await parser.getDependency("mesh", level)) as THREE.Object3D)));
  };
  return Promise.all(
    meshes.map(async (list) => {
      const mesh = parser.associations.get(list[0])?.meshes ?? -1;
      if (!known.has(mesh)) known.set(mesh, levelsOf(mesh));
      const levels = [list.map((m) => m.geometry), ...(await known.get(mesh)!)];
      if (levels.some((level) => level.length !== list.length)) throw new Error("scene.glb has a level of detail that is no level of its mesh.");
      return levels;
    }),
  );
}

function geometriesOf(node: THREE.Object3D): THREE.BufferGeometry[] {
  const out: THREE.BufferGeometry[] = [];
  node.traverse((n) => {
    if ((n as THREE.Mesh).isMesh) out.push((n as THREE.Mesh).geometry);
  });
  return out;
}

export class LevelMesh {
  readonly renderer: THREE.WebGLRenderer;
  notice = "";
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera();
  private readonly mode = { value: 0 };
  private readonly shared: Record<string, THREE.IUniform>;
  private readonly materials = new Map<THREE.Material, THREE.ShaderMaterial>();
  meshes: THREE.Mesh[][] = []; // of each object
  geometries: THREE.BufferGeometry[][][] = []; // of each object: of each level: of each mesh
  private readonly drawn: THREE.Object3D[] = [];

  constructor(canvas: HTMLCanvasElement, gl: WebGL2RenderingContext, lighting: Lighting) {
    this.renderer = new THREE.WebGLRenderer({ canvas, context: gl, antialias: false, alpha: false });
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // the shader encodes
    this.scene.matrixWorldAutoUpdate = false;
    this.scene.children = this.drawn; // filled anew every frame; parents are never asked
    this.camera.matrixAutoUpdate = false;
    this.camera.matrixWorldAutoUpdate = false;
    const vector = (v: [number, number, number]): THREE.IUniform => ({ value: new THREE.Vector3(...v) });
    this.shared = {
      u_mode: this.mode, u_sun_direction: vector(lighting.sun_direction), u_sun: vector(lighting.sun), u_sky: vector(lighting.sky),
      u_ground: vector(lighting.ground),
    };
  }

  get ready(): boolean {
    return this.meshes.length > 0;
  }

  /** Parses a GLB whose nodes carry `extras.object`; throws if it lacks one of the n objects or of its levels (CSR). */
  async load(glb: ArrayBuffer, n: number, levelRow: Int32Array): Promise<void> {
    const gltf = await new GLTFLoader().parseAsync(glb, "");
    this.notice = String((gltf.asset as { copyright?: string }).copyright ?? "");
    const meshes: THREE.Mesh[][] = Array.from({ length: n }, () => []);
    gltf.scene.updateMatrixWorld(true);
    const walk = (node: THREE.Object3D, inherited: number): void => {
      const stated = node.userData.object;
      const object = Number.isInteger(stated) && stated >= 0 && stated < n ? (stated as number) : inherited;
      const mesh = node as THREE.Mesh;
      if (mesh.isMesh && object >= 0) meshes[object].push(mesh);
      for (const child of node.children) walk(child, object);
    };
    walk(gltf.scene, -1);
    const missing = meshes.findIndex((list) => !list.length);
    if (missing >= 0) throw new Error(`scene.glb does not belong to this placement: it has no object ${missing}.`);
    for (const mesh of meshes.flat()) {
      const material = mesh.material as THREE.Material;
      mesh.material = this.shaded(material, mesh.geometry);
      mesh.frustumCulled = false;
      mesh.matrixAutoUpdate = false;
      mesh.matrixWorldAutoUpdate = false;
      mesh.children = [];
    }
    this.geometries = await readLevels(gltf, meshes);
    const bare = this.geometries.findIndex((levels, o) => levels.length - 1 < (levelRow[o + 1] ?? 0) - (levelRow[o] ?? 0));
    if (bare >= 0) throw new Error(`scene.glb does not belong to this placement: object ${bare} lacks levels of detail.`);
    this.meshes = meshes;
  }

  /** Draws the selected objects into the current viewport and scissor of the renderer. */
  draw(view: View, { objects, nObjects: n, levels }: Selection, stats: DrawStats): void {
    this.setCamera(view);
    this.mode.value = view.mode;
    let k = 0;
    for (let i = 0; i < n; i++) {
      const list = this.meshes[objects[i]];
      const geometry = this.geometries[objects[i]][levels[objects[i]]];
      for (let j = 0; j < list.length; j++) {
        list[j].geometry = geometry[j];
        this.drawn[k++] = list[j];
      }
    }
    this.drawn.length = k;
    this.renderer.info.reset();
    this.renderer.render(this.scene, this.camera);
    stats.calls += this.renderer.info.render.calls;
    stats.triangles += this.renderer.info.render.triangles;
  }

  private setCamera(view: View): void {
    const { frame, near, far, tanX, tanY } = view;
    const { eye, right: r, up: u, forward: f } = frame;
    this.camera.matrixWorld.set(r[0], u[0], -f[0], eye[0], r[1], u[1], -f[1], eye[1], r[2], u[2], -f[2], eye[2], 0, 0, 0, 1);
    this.camera.matrixWorldInverse.copy(this.camera.matrixWorld).invert();
    this.camera.projectionMatrix.makePerspective(-near * tanX, near * tanX, near * tanY, -near * tanY, near, far);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
  }

  private shaded(source: THREE.Material, geometry: THREE.BufferGeometry): THREE.ShaderMaterial {
    const known = this.materials.get(source);
    if (known) return known;
    const from = source as THREE.MeshStandardMaterial;
    const map = from.map ?? null;
    const emissive = from.emissive ? from.emissive.clone().multiplyScalar(from.emissiveIntensity ?? 1) : new THREE.Color(0);
    const color = from.color ?? new THREE.Color(1, 1, 1);
    if (map) map.updateMatrix();
    const defines: Record<string, string> = {};
    const glow = from.emissiveMap ?? null;
    if (map) defines.TEXTURED = "";
    if (glow) defines.GLOWING = "";
    if (glow?.channel === 1) defines.GLOW_APART = "";
    if ((source as THREE.MeshBasicMaterial).isMeshBasicMaterial) defines.UNLIT = "";
    if (from.side === THREE.DoubleSide) defines.TWO_SIDED = "";
    if (from.transparent) defines.BLENDED = "";
    const colors = geometry.getAttribute("color");
    const made = new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3, vertexShader: vertexSource, fragmentShader: fragmentSource, defines, side: from.side,
      transparent: from.transparent, depthWrite: !from.transparent, vertexColors: from.vertexColors && !!colors,
      toneMapped: false, fog: false, lights: false,
      uniforms: {
        ...this.shared,
        u_base: { value: new THREE.Vector4(color.r, color.g, color.b, from.opacity) },
        u_emissive: { value: new THREE.Vector3(emissive.r, emissive.g, emissive.b) },
        u_cutoff: { value: from.alphaTest },
        u_map: { value: map },
        u_glow: { value: glow },
        u_uv_transform: { value: map ? map.matrix : new THREE.Matrix3() },
      },
    });
    this.materials.set(source, made);
    return made;
  }
}
