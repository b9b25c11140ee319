/** The whole level as three.js meshes, every object at hand: what other ways to draw it begin with. */
import * as THREE from "three";
import type { Engine } from "../viewer/engine";
import type { Placement } from "../placementdb/placement";
import type { Frame } from "./frame";

export class Whole {
  private readonly scene = new THREE.Scene();
  private readonly drawn: THREE.Object3D[] = [];

  constructor(readonly renderer: THREE.WebGLRenderer, readonly meshes: THREE.Mesh[][]) {
    this.scene.matrixWorldAutoUpdate = false;
    this.scene.children = this.drawn; // filled anew every frame
  }

  /** Draws the first n of `objects`; `shape` says with which geometry each mesh is drawn, left out: its own. */
  draw(frame: Frame, objects: ArrayLike<number>, n: number, drawn: { calls: number; triangles: number }, shape?: (o: number, part: number) => THREE.BufferGeometry): void {
    let k = 0;
    for (let i = 0; i < n; i++) {
      const meshes = this.meshes[objects[i]];
      for (let j = 0; j < meshes.length; j++) {
        if (shape) meshes[j].geometry = shape(objects[i], j);
        this.drawn[k++] = meshes[j];
      }
    }
    this.drawn.length = k;
    frame.render(this.renderer, this.scene);
    drawn.calls += this.renderer.info.render.calls;
    drawn.triangles += this.renderer.info.render.triangles;
  }
}

/** Parses scene.glb. */
export async function loadWhole(engine: Engine, placement: Placement, glb: ArrayBuffer): Promise<Whole> {
  await engine.level.load(glb, placement.manifest.counts.objects, placement.index.levelRow);
  return new Whole(engine.level.renderer, engine.level.meshes);
}
