/**
 * three.js' BatchedMesh: one multi-draw for all objects of a material, as its documentation recommends for many different meshes.
 *
 * Plain materials (no texture, no glow, opaque) differ in colour only and share one batch, their colours in its table. Culling is
 * BatchedMesh's own, by bounding spheres.
 */
import * as THREE from "three";
import { MESH_SHADERS, withSurface } from "../shaders/surface";
import vertexSource from "./batched_mesh.vertex.glsl?raw";
import type { Vec3 } from "../placementdb/manifest";
import { here, type Given, type Way } from "./way";

interface Group {
  material: THREE.ShaderMaterial;
  plain: boolean;
  meshes: THREE.Mesh[];
}

export async function batchedWay({ whole, frame }: Given): Promise<Way> {
  const { meshes, renderer } = await whole();
  const groups = new Map<string, Group>();
  for (const mesh of meshes.flat()) {
    const material = mesh.material as THREE.ShaderMaterial;
    const plain = isPlain(material);
    const look = plain ? `plain ${material.side} ${Object.keys(material.defines).sort()}` : material.uuid;
    const shape = Object.entries(mesh.geometry.attributes).map(([name, a]) => `${name} ${a.itemSize} ${a.normalized} ${a.array.constructor.name}`);
    const key = plain ? look : `${look} ${shape.sort()} ${mesh.geometry.index !== null}`;
    const group = groups.get(key);
    if (group) group.meshes.push(mesh);
    else groups.set(key, { material, plain, meshes: [mesh] });
  }
  const scene = new THREE.Scene();
  scene.matrixWorldAutoUpdate = false;
  for (const group of groups.values()) scene.add(batchOf(group));
  return {
    claimed: null,
    preparedBytes: 0,
    said: `${groups.size} batches`,
    settle: here,
    draw: (position: Vec3, direction: Vec3) => {
      frame.begin(position, direction);
      frame.render(renderer, scene);
      frame.end();
    },
  };
}

function isPlain({ defines, transparent, vertexColors, uniforms: u }: THREE.ShaderMaterial): boolean {
  const glows = (u.u_emissive.value as THREE.Vector3).lengthSq() > 0;
  return !transparent && !vertexColors && !glows && !(u.u_cutoff.value > 0) && !("TEXTURED" in defines) && !("GLOWING" in defines);
}

function batchOf({ material, plain, meshes }: Group): THREE.BatchedMesh {
  const made = material.clone();
  made.vertexShader = withSurface(vertexSource);
  made.fragmentShader = MESH_SHADERS.fragmentShader;
  const shapes = new Map<THREE.BufferGeometry, THREE.BufferGeometry>();
  for (const { geometry } of meshes) if (!shapes.has(geometry)) shapes.set(geometry, shapeOf(geometry, plain));
  const sum = (count: (g: THREE.BufferGeometry) => number): number => [...shapes.values()].reduce((n, g) => n + count(g), 0);
  const batch = new THREE.BatchedMesh(meshes.length, sum((g) => g.getAttribute("position").count), sum((g) => g.index!.count), made);
  batch.sortObjects = material.transparent;
  batch.frustumCulled = false; // its objects are
  batch.matrixAutoUpdate = batch.matrixWorldAutoUpdate = false;
  const ids = new Map([...shapes].map(([from, shape]) => [from, batch.addGeometry(shape)]));
  const color = new THREE.Color();
  for (const mesh of meshes) {
    const id = batch.addInstance(ids.get(mesh.geometry)!);
    batch.setMatrixAt(id, mesh.matrixWorld);
    if (!plain) continue;
    const base = (mesh.material as THREE.ShaderMaterial).uniforms.u_base.value as THREE.Vector4;
    batch.setColorAt(id, color.setRGB(base.x, base.y, base.z, THREE.LinearSRGBColorSpace));
  }
  if (plain) made.uniforms.u_base.value = new THREE.Vector4(1, 1, 1, 1);
  return batch;
}

/** The geometry with an index, and with nothing that a plain material does not read. */
function shapeOf(geometry: THREE.BufferGeometry, plain: boolean): THREE.BufferGeometry {
  const out = new THREE.BufferGeometry();
  for (const [name, attribute] of Object.entries(geometry.attributes)) {
    if (!plain || name === "position" || name === "normal") out.setAttribute(name, attribute);
  }
  const n = geometry.getAttribute("position").count;
  out.setIndex(geometry.index ?? new THREE.BufferAttribute(Uint32Array.from({ length: n }, (_, k) => k), 1));
  return out;
}
