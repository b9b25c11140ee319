/**
 * The whole level from `scene.glb`, for placements that have it nowhere else (written before format version 6): loaded at
 * once, every object a mesh of its own. A level of detail is another geometry: `extras.levels` of a glTF mesh names the meshes
 * that are its levels.
 */
import * as THREE from "three";
import { GLTFLoader, type GLTF } from "three/addons/loaders/GLTFLoader.js";
import type { Materials } from "./materials";

export interface WholeLevel {
  notice: string;
  matrices: Float64Array; // (N,16) column-major
  geometries: THREE.BufferGeometry[][][]; // of each object: of each level: of each primitive
  meshes: THREE.Mesh[][]; // of each object, with the materials that it is drawn with
}

/** Parses a GLB whose nodes carry `extras.object`; throws if it lacks one of the n objects or of its levels (CSR). */
export async function readGlb(glb: ArrayBuffer, n: number, levelRow: Int32Array, materials: Materials): Promise<WholeLevel> {
  const gltf = await new GLTFLoader().parseAsync(glb, "");
  const meshes: THREE.Mesh[][] = Array.from({ length: n }, () => []);
  gltf.scene.updateMatrixWorld(true);
  const walk = (node: THREE.Object3D, inherited: number): void => {
    const stated = node.userData.object;
    const object = Number.isInteger(stated) && stated >= 0 && stated < n ? (stated as number) : inherited;
    if ((node as THREE.Mesh).isMesh && object >= 0) meshes[object].push(node as THREE.Mesh);
    for (const child of node.children) walk(child, object);
  };
  walk(gltf.scene, -1);
  const missing = meshes.findIndex((list) => !list.length);
  if (missing >= 0) throw new Error(`scene.glb does not belong to this placement: it has no object ${missing}.`);
  const matrices = new Float64Array(16 * n);
  meshes.forEach((list, o) => matrices.set(list[0].matrixWorld.elements, 16 * o));
  const known = new Map<THREE.Material, THREE.ShaderMaterial>();
  const shaded = (mesh: THREE.Mesh): THREE.ShaderMaterial => {
    const source = mesh.material as THREE.Material;
    let made = known.get(source);
    if (!made) known.set(source, (made = materials.make(lookOf(source as THREE.MeshStandardMaterial, mesh.geometry))));
    return made;
  };
  for (const mesh of meshes.flat()) {
    mesh.material = shaded(mesh);
    mesh.frustumCulled = false;
    mesh.matrixAutoUpdate = false;
    mesh.matrixWorldAutoUpdate = false;
    mesh.children = [];
  }
  const geometries = await readLevels(gltf, meshes);
  const bare = geometries.findIndex((levels, o) => levels.length - 1 < (levelRow[o + 1] ?? 0) - (levelRow[o] ?? 0));
  if (bare >= 0) throw new Error(`scene.glb does not belong to this placement: object ${bare} lacks levels of detail.`);
  return {
    notice: String((gltf.asset as { copyright?: string }).copyright ?? ""), matrices, geometries,
    meshes,
  };
}

function lookOf(from: THREE.MeshStandardMaterial, geometry: THREE.BufferGeometry): Parameters<Materials["make"]>[0] {
  const color = from.color ?? new THREE.Color(1, 1, 1);
  const emissive = from.emissive ? from.emissive.clone().multiplyScalar(from.emissiveIntensity ?? 1) : new THREE.Color(0);
  const map = from.map ?? null;
  const glow = from.emissiveMap ?? null;
  if (map) map.updateMatrix();
  return {
    base: [color.r, color.g, color.b, from.opacity], emissive: [emissive.r, emissive.g, emissive.b], cutoff: from.alphaTest,
    blended: from.transparent, unlit: Boolean((from as unknown as THREE.MeshBasicMaterial).isMeshBasicMaterial), twoSided: from.side === THREE.DoubleSide,
    map, glow, glowApart: glow?.channel === 1, colored: from.vertexColors && !!geometry.getAttribute("color"),
    ...(map ? { uvTransform: map.matrix } : {}),
  };
}

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
