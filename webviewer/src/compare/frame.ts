/** What every way to draw shares: the camera, exact culling, and the target that averages four samples a pixel. */
import * as THREE from "three";
import { farthest, makeView, setViewProjection, type View } from "../draw/view";
import { PictureTarget } from "../gl/picture_target";
import type { Vec3 } from "../placementdb/manifest";
import type { Placement } from "../placementdb/placement";
import { cameraFrame, makeFrustum, setFrustum } from "../select/frustum";
import { Selector, type Selection } from "../select/select";

const NEAR_M = 0.1; // as the engine's

/** sRGB, as the engine's background; and in linear light, as the target is cleared. */
export const BACKGROUND: Vec3 = [0.62, 0.74, 0.82];
const CLEARED = BACKGROUND.map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));

export class Frame {
  readonly view: View = makeView();
  readonly camera = new THREE.PerspectiveCamera();
  readonly target: PictureTarget;
  private readonly frustum = makeFrustum();
  private readonly selector: Selector;
  private readonly local: Vec3 = [0, 0, 0];

  constructor(readonly gl: WebGL2RenderingContext, private readonly placement: Placement) {
    this.target = new PictureTarget(gl);
    this.selector = new Selector(placement.index, placement.manifest);
    this.selector.setView(-1, null, null, []);
    this.camera.matrixAutoUpdate = false;
    this.camera.matrixWorldAutoUpdate = false;
  }

  /** Takes the camera, clears the target, and returns the objects whose box meets the view pyramid. */
  begin(position: Vec3, direction: Vec3): Selection {
    const { view, frustum, local, gl, camera, placement: { manifest } } = this;
    const { width, height } = gl.canvas;
    cameraFrame(position, direction, view.frame);
    setFrustum(frustum, view.frame, manifest.camera.fov_deg, manifest.camera.width / manifest.camera.height);
    for (let a = 0; a < 3; a++) local[a] = position[a] - manifest.origin_m[a];
    frustum.eye = local;
    [view.tanX, view.tanY, view.near, view.far] = [frustum.tanX, frustum.tanY, NEAR_M, farthest(position, manifest.bounds)];
    setViewProjection(view);
    const { eye, right: r, up: u, forward: f } = view.frame;
    camera.matrixWorld.set(r[0], u[0], -f[0], eye[0], r[1], u[1], -f[1], eye[1], r[2], u[2], -f[2], eye[2], 0, 0, 0, 1);
    camera.matrixWorldInverse.copy(camera.matrixWorld).invert();
    const [x, y] = [view.near * view.tanX, view.near * view.tanY];
    camera.projectionMatrix.makePerspective(-x, x, y, -y, view.near, view.far);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    this.target.bind(width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.viewport(0, 0, width, height);
    gl.colorMask(true, true, true, true);
    gl.depthMask(true);
    gl.clearColor(CLEARED[0], CLEARED[1], CLEARED[2], 1);
    gl.clearDepth(1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    return this.selector.select(frustum);
  }

  /** Lets three.js draw a scene into the target. */
  render(renderer: THREE.WebGLRenderer, scene: THREE.Scene): void {
    const { width, height } = this.gl.canvas;
    renderer.resetState();
    this.target.bind(width, height);
    renderer.setViewport(0, 0, width, height);
    renderer.setScissorTest(false);
    renderer.info.reset();
    renderer.render(scene, this.camera);
  }

  end(): void {
    this.target.show();
  }
}
