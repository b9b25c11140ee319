/** Materials as the bake shades them: one shader, its variants by defines. */
import * as THREE from "three";
import type { GeometryIndex } from "../placementdb/geometry";
import { MESH_SHADERS } from "../shaders/surface";

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

export interface Look {
  base: ArrayLike<number>; // linear RGBA
  emissive: ArrayLike<number>; // linear
  cutoff: number; // 0: not cut out
  blended: boolean;
  unlit: boolean;
  twoSided: boolean;
  map: THREE.Texture | null;
  glow: THREE.Texture | null;
  glowApart: boolean; // by texture coordinates of its own
  colored: boolean; // by vertex colours too
  uvTransform?: THREE.Matrix3;
}

export class Materials {
  readonly mode = { value: 0 };
  private readonly shared: Record<string, THREE.IUniform>;

  constructor(lighting: Lighting) {
    const vector = (v: [number, number, number]): THREE.IUniform => ({ value: new THREE.Vector3(...v) });
    this.shared = {
      u_mode: this.mode, u_sun_direction: vector(lighting.sun_direction), u_sun: vector(lighting.sun), u_sky: vector(lighting.sky),
      u_ground: vector(lighting.ground),
    };
  }

  make(look: Look): THREE.ShaderMaterial {
    const defines: Record<string, string> = {};
    if (look.map) defines.TEXTURED = "";
    if (look.glow) defines.GLOWING = "";
    if (look.glow && look.glowApart) defines.GLOW_APART = "";
    if (look.unlit) defines.UNLIT = "";
    if (look.twoSided) defines.TWO_SIDED = "";
    if (look.blended) defines.BLENDED = "";
    return new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3, ...MESH_SHADERS, defines,
      side: look.twoSided ? THREE.DoubleSide : THREE.FrontSide,
      transparent: look.blended, depthWrite: !look.blended, vertexColors: look.colored,
      toneMapped: false, fog: false, lights: false,
      uniforms: {
        ...this.shared,
        u_base: { value: new THREE.Vector4(look.base[0], look.base[1], look.base[2], look.base[3]) },
        u_emissive: { value: new THREE.Vector3(look.emissive[0], look.emissive[1], look.emissive[2]) },
        u_cutoff: { value: look.cutoff },
        u_map: { value: look.map },
        u_glow: { value: look.glow },
        u_uv_transform: { value: look.uvTransform ?? new THREE.Matrix3() },
      },
    });
  }
}

const WRAPS: Record<number, THREE.Wrapping> = { 33071: THREE.ClampToEdgeWrapping, 33648: THREE.MirroredRepeatWrapping, 10497: THREE.RepeatWrapping };
const OPAQUE = 0;
const MASK = 1;
const BLEND = 2;

/** The materials of a level in pages. A texture is one texel of its mean colour until its file is here. */
export class PagedMaterials {
  readonly all: THREE.ShaderMaterial[] = []; // 2 k: material k, 2 k + 1: with vertex colours
  /** Of each of `all`: how many of its texture files are not here. */
  readonly pending: Uint8Array;
  private readonly means: THREE.Texture[];
  private readonly users: number[][]; // materials k of each texture

  constructor(private readonly index: GeometryIndex, materials: Materials) {
    const n = index.alpha.length;
    this.means = Array.from(index.textureFile, (_, x) => this.configured(new THREE.DataTexture(new Uint8Array([...index.textureColor.subarray(3 * x, 3 * x + 3), 255]), 1, 1), x));
    this.users = this.means.map(() => []);
    this.pending = new Uint8Array(2 * n);
    for (let k = 0; k < n; k++) {
      const map = index.texture[k];
      const glow = index.glow[k];
      for (const x of new Set([map, glow])) {
        if (x < 0) continue;
        this.users[x].push(k);
        this.pending[2 * k]++;
        this.pending[2 * k + 1]++;
      }
      for (const colored of [false, true]) {
        this.all.push(materials.make({
          base: index.baseColor.subarray(4 * k, 4 * k + 4), emissive: index.emissive.subarray(3 * k, 3 * k + 3),
          cutoff: index.alpha[k] === MASK ? index.cutoff[k] : OPAQUE, blended: index.alpha[k] === BLEND, unlit: index.unlit[k] !== 0,
          twoSided: index.twoSided[k] !== 0, map: this.means[map] ?? null, glow: this.means[glow] ?? null, glowApart: index.glowApart[k] !== 0, colored,
        }));
      }
    }
  }

  /** Shows an image in every texture of a file; null: it is gone again. */
  setFile(file: number, image: ImageBitmap | null): void {
    const { textureFile, texture, glow } = this.index;
    for (let x = 0; x < textureFile.length; x++) {
      if (textureFile[x] !== file) continue;
      const shown = image ? this.configured(new THREE.Texture(image), x) : this.means[x];
      for (const k of this.users[x]) {
        for (const at of [2 * k, 2 * k + 1]) {
          const { u_map, u_glow } = this.all[at].uniforms;
          if (texture[k] === x) this.swap(u_map, x, shown);
          if (glow[k] === x) this.swap(u_glow, x, shown);
          this.pending[at] += image ? -1 : 1;
        }
      }
    }
  }

  private swap(uniform: THREE.IUniform, x: number, shown: THREE.Texture): void {
    const before = uniform.value as THREE.Texture;
    uniform.value = shown;
    if (before === this.means[x]) return;
    before.dispose();
    (before.image as ImageBitmap).close();
  }

  private configured(texture: THREE.Texture, x: number): THREE.Texture {
    const { textureWrap, textureLinear, textureSmooth } = this.index;
    texture.flipY = false;
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.wrapS = WRAPS[textureWrap[2 * x]] ?? THREE.RepeatWrapping;
    texture.wrapT = WRAPS[textureWrap[2 * x + 1]] ?? THREE.RepeatWrapping;
    texture.magFilter = textureLinear[x] ? THREE.LinearFilter : THREE.NearestFilter;
    texture.minFilter = textureSmooth[x] ? THREE.LinearMipmapLinearFilter : THREE.NearestMipmapNearestFilter;
    texture.generateMipmaps = true;
    texture.needsUpdate = true;
    return texture;
  }
}
