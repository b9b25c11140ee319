/**
 * Simplified meshes, switched by distance: meshoptimizer's levels of a half, a quarter and an eighth of the triangles, each shown where
 * the error that the simplifier states projects to at most one pixel. Nothing is promised: that error is an estimate.
 */
import { MeshoptSimplifier } from "meshoptimizer/simplifier";
import * as THREE from "three";
import type { Vec3 } from "../placementdb/manifest";
import { here, type Given, type Way } from "./way";

const SHARES = [0.5, 0.25, 0.125];
const FEWEST = 8; // triangles of a mesh that is worth simplifying
const WORTH = 0.9; // a level has at most this share of the triangles of the one before
const MOST_ERROR = 0.1; // of the mesh's size
const PIXELS = 1;

interface Level {
  geometry: THREE.BufferGeometry;
  error: number; // mesh-local length
}

export async function simplifiedWay({ whole, placement, frame }: Given): Promise<Way> {
  await MeshoptSimplifier.ready;
  const level = await whole();
  const known = new Map<THREE.BufferGeometry, Level[]>();
  let bytes = 0;
  for (const mesh of level.meshes.flat()) {
    if (known.has(mesh.geometry)) continue;
    const levels = levelsOf(mesh.geometry);
    for (const { geometry } of levels) bytes += geometry.index!.array.byteLength;
    known.set(mesh.geometry, levels);
  }
  // Object by object: level k of an object is level k of each of its meshes, or the coarsest that a mesh has.
  const shapes: THREE.BufferGeometry[][][] = []; // of each object: of each level: of each mesh
  const errors = level.meshes.map((meshes, o) => {
    shapes[o] = [meshes.map((m) => m.geometry)];
    const depth = Math.max(...meshes.map((m) => known.get(m.geometry)!.length));
    const found: number[] = [];
    for (let k = 0; k < depth; k++) {
      const at = meshes.map((m) => known.get(m.geometry)![Math.min(k, known.get(m.geometry)!.length - 1)]);
      shapes[o][k + 1] = meshes.map((m, j) => at[j]?.geometry ?? m.geometry);
      found.push(Math.max(...meshes.map((m, j) => (at[j]?.error ?? 0) * m.matrixWorld.getMaxScaleOnAxis())));
    }
    return found;
  });
  const { objectBox } = placement.index;
  const { height } = placement.manifest.camera;
  const drawn = { calls: 0, triangles: 0 };
  return {
    claimed: drawn,
    preparedBytes: bytes,
    said: `${errors.reduce((n, e) => n + e.length, 0)} levels of ${errors.length} objects`,
    settle: here,
    draw: (position: Vec3, direction: Vec3) => {
      const selection = frame.begin(position, direction);
      const focal = height / (2 * frame.view.tanY);
      const eye = position.map((x, a) => x - placement.manifest.origin_m[a]);
      for (let i = 0; i < selection.nObjects; i++) {
        const o = selection.objects[i];
        let gap2 = 0;
        for (let a = 0; a < 3; a++) gap2 += Math.max(objectBox[6 * o + a] - eye[a], eye[a] - objectBox[6 * o + 3 + a], 0) ** 2;
        const allowed = (PIXELS * Math.sqrt(gap2)) / focal;
        let k = errors[o].length;
        while (k > 0 && errors[o][k - 1] > allowed) k--;
        selection.levels[o] = k;
      }
      drawn.calls = drawn.triangles = 0;
      level.draw(frame, selection.objects, selection.nObjects, drawn, (o, part) => shapes[o][selection.levels[o]][part]);
      frame.end();
    },
  };
}

function levelsOf(geometry: THREE.BufferGeometry): Level[] {
  const from = geometry.getAttribute("position");
  const position = new Float32Array(3 * from.count);
  for (let k = 0; k < from.count; k++) position.set([from.getX(k), from.getY(k), from.getZ(k)], 3 * k);
  const index = geometry.index ? Uint32Array.from(geometry.index.array) : Uint32Array.from({ length: from.count }, (_, k) => k);
  if (index.length < 3 * FEWEST) return [];
  const scale = MeshoptSimplifier.getScale(position, 3);
  const out: Level[] = [];
  let before = index.length;
  for (const share of SHARES) {
    const [coarse, error] = MeshoptSimplifier.simplify(index, position, 3, 3 * Math.ceil((share * index.length) / 3), MOST_ERROR);
    if (!coarse.length || coarse.length > WORTH * before) continue;
    before = coarse.length;
    const made = new THREE.BufferGeometry();
    for (const [name, attribute] of Object.entries(geometry.attributes)) made.setAttribute(name, attribute);
    made.setIndex(new THREE.BufferAttribute(from.count < 65536 ? Uint16Array.from(coarse) : coarse, 1));
    out.push({ geometry: made, error: error * scale });
  }
  return out;
}
