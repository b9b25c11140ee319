"""The output of stage 1."""

from dataclasses import dataclass

import numpy as np

OPAQUE, MASK, BLEND = 0, 1, 2

# What of an object no picture taken beforehand can show: bit k of Scene.object_look. The first two never are replaced; the
# others stay geometry or are baked as they stand in the light of `farfield.bake.shade`, as `bake.flatten` says.
LOOKS = ("blended", "transmissive", "shiny", "animated", "skinned", "morphed")
BLENDED, TRANSMISSIVE, SHINY, ANIMATED, SKINNED, MORPHED = (1 << k for k in range(6))
KEPT = {  # by `bake.flatten`: objects with any of these looks stay geometry
    "none": BLENDED | TRANSMISSIVE | SHINY | ANIMATED | SKINNED | MORPHED,
    "shine": BLENDED | TRANSMISSIVE | ANIMATED | SKINNED | MORPHED,
    "all": BLENDED | TRANSMISSIVE,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A static level: M meshes, N objects (placed meshes), K materials, X textures.

    Object ids are final: objects stand in depth-first order of the hierarchy (Morton order on the fixed grid, ties by
    box corners, triangles, calls): a cluster is a range of ids. All coordinates but `origin_m` are metres, y up,
    right-handed, relative to `origin_m`, a point of the fixed grid. Public ("scene") coordinates = these + origin_m.
    """

    origin_m: np.ndarray  # (3,)  f64  scene metres
    cell_m: float  # side of the smallest view-space cell; the grid's spacing is a power of two times it
    view_boxes: np.ndarray  # (B,2,3) f64  the view space, relative to origin_m
    # vertices, mesh-local; float32 is what is drawn, counted and baked alike (loss: 2**-24 of the mesh's extent)
    position: np.ndarray  # (Y,3) f32
    normal: np.ndarray  # (Y,3) f32  unit; computed where the file has none
    uv: np.ndarray  # (Y,2) f32  texture coordinates, texture transform applied; 0 where none
    emissive_uv: np.ndarray  # (Y,2) f32  those of emissive textures, or (0,2): all of them take `uv`
    color: np.ndarray  # (Y,4) f32  linear RGBA vertex colour; 1 where none
    index: np.ndarray  # (T,3) i32  into the vertex arrays
    # primitives: one draw call each
    primitive_triangle: np.ndarray  # (P+1,) i64  primitive p has triangles [p, p+1)
    primitive_vertex: np.ndarray  # (P+1,) i64  ... and uses only vertices of this range
    primitive_material: np.ndarray  # (P,) i32
    mesh_primitive: np.ndarray  # (M+1,) i64  mesh m has primitives [m, m+1)
    # objects
    object_mesh: np.ndarray  # (N,) i32
    object_matrix: np.ndarray  # (N,3,4) f64  mesh-local -> relative to origin_m; det < 0 mirrors, as in glTF
    object_box: np.ndarray  # (N,2,3) f64  exact box of the transformed float32 vertices, computed in float64
    object_triangles: np.ndarray  # (N,) i64
    object_calls: np.ndarray  # (N,) i64  primitives
    object_bytes: np.ndarray  # (N,) i64  geometry bytes of its mesh (36 a vertex, 12 a triangle), shared or not
    object_replaceable: np.ndarray  # (N,) b1  False: it stays geometry, for what `object_look` says
    object_look: np.ndarray  # (N,) u1  what cannot be baked of it: bit k is LOOKS[k]
    object_name: tuple[str, ...]
    # materials
    material_base_color: np.ndarray  # (K,4) f32  linear
    material_emissive: np.ndarray  # (K,3) f32  linear; times its texture
    material_unlit: np.ndarray  # (K,) b1  shows its base colour whatever the light
    material_alpha_mode: np.ndarray  # (K,) u1   OPAQUE, MASK, BLEND
    material_alpha_cutoff: np.ndarray  # (K,) f32
    material_double_sided: np.ndarray  # (K,) b1
    material_texture: np.ndarray  # (K,) i32  base-colour texture, -1 none
    material_emissive_texture: np.ndarray  # (K,) i32  -1 none
    material_name: tuple[str, ...]
    # textures: encoded images (PNG, JPEG, WebP)
    texture_byte: np.ndarray  # (X+1,) i64  image x is texture_data[x, x+1)
    texture_data: np.ndarray  # (D,) u1
    texture_wrap: np.ndarray  # (X,2) i32  glTF wrap modes in s and t (33071 clamp, 33648 mirror, 10497 repeat)
    texture_linear: np.ndarray  # (X,) b1  magnified linearly (else nearest)
    texture_smooth: np.ndarray  # (X,) b1  minified between texels and levels (else nearest)
    # what was noticed
    dropped_triangles: int  # degenerate ones
    warnings: tuple[str, ...]
    notice: str = ""  # the file's copyright and attribution, shown with its pictures and kept in scene.glb

    @property
    def n_objects(self) -> int:
        return len(self.object_mesh)
