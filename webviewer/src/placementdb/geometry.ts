/** The level in pages (format section 8): which mesh each object shows, materials, and pages of models. No WebGL. */
import { ColumnReader, type Container } from "./columns";
import { ColumnsAltered } from "./errors";
import type { PlacementIndex } from "./index_file";
import type { Manifest } from "./manifest";

export interface GeometryIndex {
  objectMesh: Int32Array;
  objectMatrix: Float64Array; // (N,3,4) rows; mesh to relative to origin_m
  objectColor: Uint8Array; // (N,3) sRGB
  meshPrimitive: Int32Array; // mesh m has primitives [m, m+1)
  primitiveMaterial: Int32Array;
  meshModel: Int32Array; // mesh m has models [m, m+1): itself, then its levels, finer first
  modelPage: Int32Array; // -1: no object shows it
  modelSlot: Int32Array; // its place in the page
  baseColor: Float32Array; // (K,4) linear
  emissive: Float32Array; // (K,3) linear
  alpha: Uint8Array; // 0 opaque, 1 mask, 2 blend
  cutoff: Float32Array;
  unlit: Uint8Array;
  twoSided: Uint8Array;
  texture: Int32Array; // -1 none
  glow: Int32Array; // emissive texture, -1 none
  glowApart: Uint8Array; // by texture coordinates of its own
  textureFile: Int32Array;
  textureWrap: Int32Array; // (X,2) glTF wrap modes
  textureLinear: Uint8Array;
  textureSmooth: Uint8Array;
  textureColor: Uint8Array; // (X,3) sRGB mean
}

/** A page's models, part after part; `index` counts vertices of the page. */
export interface GeometryPage {
  modelPart: Int32Array;
  partTriangle: Int32Array;
  position: Float32Array;
  normal: Float32Array;
  uv: Float32Array; // empty where nothing has any, as glowUv and color
  glowUv: Float32Array;
  color: Float32Array;
  index: Uint32Array;
}

export function readGeometryIndex(container: Container, where: string, manifest: Manifest, index: PlacementIndex): GeometryIndex {
  if (container.kind !== "GeometryIndex") throw new ColumnsAltered(where, `it holds ${container.kind}, not GeometryIndex`);
  const r = new ColumnReader(container, where);
  const { pages, textures } = manifest.geometry!;
  const N = manifest.counts.objects;
  const M = r.length("mesh_model") - 1;
  const Q = r.length("model_page");
  const P = r.length("primitive_material");
  const K = r.length("material_alpha");
  const X = r.length("texture_file");
  const out: GeometryIndex = {
    objectMesh: r.ids("object_mesh", r.i4("object_mesh", N), 0, M),
    objectMatrix: r.f8("object_matrix", N, 3, 4),
    objectColor: r.u1("object_color", N, 3),
    meshPrimitive: r.rows("mesh_primitive", r.i4("mesh_primitive", M + 1), P),
    primitiveMaterial: r.ids("primitive_material", r.i4("primitive_material", P), 0, K),
    meshModel: r.rows("mesh_model", r.i4("mesh_model", M + 1), Q),
    modelPage: r.ids("model_page", r.i4("model_page", Q), -1, pages.length),
    modelSlot: r.i4("model_slot", Q),
    baseColor: r.f4("material_base_color", K, 4),
    emissive: r.f4("material_emissive", K, 3),
    alpha: r.u1("material_alpha", K),
    cutoff: r.f4("material_cutoff", K),
    unlit: r.u1("material_unlit", K),
    twoSided: r.u1("material_two_sided", K),
    texture: r.ids("material_texture", r.i4("material_texture", K), -1, X),
    glow: r.ids("material_glow", r.i4("material_glow", K), -1, X),
    glowApart: r.u1("material_glow_apart", K),
    textureFile: r.ids("texture_file", r.i4("texture_file", X), 0, textures.length),
    textureWrap: r.i4("texture_wrap", X, 2),
    textureLinear: r.u1("texture_linear", X),
    textureSmooth: r.u1("texture_smooth", X),
    textureColor: r.u1("texture_color", X, 3),
  };
  for (let o = 0; o < N; o++) {
    const mesh = out.objectMesh[o];
    const first = out.meshModel[mesh];
    const levels = index.levelRow.length ? index.levelRow[o + 1] - index.levelRow[o] : 0;
    if (out.meshModel[mesh + 1] - first < 1 + levels || out.modelPage[first] < 0) throw new ColumnsAltered(where, `object ${o} lacks one of its levels`);
  }
  return out;
}

export function readGeometryPage(container: Container, where: string, number: number): GeometryPage {
  if (container.kind !== "GeometryPage" || container.meta.page !== number) throw new ColumnsAltered(where, `it is not page ${number} of the geometry`);
  const r = new ColumnReader(container, where);
  const V = r.length("position");
  const optional = (name: string): number => (r.length(name) ? V : 0);
  const page: GeometryPage = {
    partTriangle: r.rows("part_triangle", r.i4("part_triangle", null), r.length("index")),
    modelPart: r.rows("model_part", r.i4("model_part", null), r.length("part_triangle") - 1),
    position: r.f4("position", V, 3),
    normal: r.f4("normal", V, 3),
    uv: r.f4("uv", optional("uv"), 2),
    glowUv: r.f4("glow_uv", optional("glow_uv"), 2),
    color: r.f4("color", optional("color"), 4),
    index: r.u4("index", null, 3),
  };
  r.ids("index", page.index, 0, V);
  return page;
}
