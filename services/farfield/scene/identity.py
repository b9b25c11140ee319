"""Name objects by what they are, so that two levels can be compared object by object.

Problem  Of two versions of a level, which objects are the same: as drawn, as counted, as baked, where they stand?
Method   A digest of the mesh (what its primitives index, relative to their own vertices, and how they look), the placing
         matrix and the box. Names do not count, ids do not count, nor do materials or meshes that nothing uses.
Errs     Towards different: a mesh whose vertices are stored in another order is another mesh.
"""

import hashlib

import numpy as np

from farfield.scene.model import Scene

DIGEST_BYTES = 16


def object_digests(scene: Scene) -> np.ndarray:
    """Return (N,16) u1: equal for objects of two scenes that are equal in all that a placement depends on."""
    materials = _materials(scene)
    meshes = [_mesh(scene, m, materials) for m in range(len(scene.mesh_primitive) - 1)]
    out = np.empty((scene.n_objects, DIGEST_BYTES), np.uint8)
    for o in range(scene.n_objects):
        figures = (scene.object_calls[o], scene.object_triangles[o], scene.object_bytes[o], scene.object_replaceable[o])
        placed = hashlib.sha256(meshes[scene.object_mesh[o]])
        placed.update(scene.object_matrix[o].tobytes() + scene.object_box[o].tobytes() + bytes([scene.object_look[o]]))
        placed.update(np.array(figures, np.int64).tobytes() + scene.origin_m.tobytes())
        out[o] = np.frombuffer(placed.digest()[:DIGEST_BYTES], np.uint8)
    return out


def _mesh(scene: Scene, mesh: int, materials: list[bytes]) -> bytes:
    digest = hashlib.sha256()
    for p in range(int(scene.mesh_primitive[mesh]), int(scene.mesh_primitive[mesh + 1])):
        triangles = slice(scene.primitive_triangle[p], scene.primitive_triangle[p + 1])
        vertices = slice(scene.primitive_vertex[p], scene.primitive_vertex[p + 1])
        digest.update(materials[scene.primitive_material[p]])
        digest.update(np.array([triangles.stop - triangles.start, vertices.stop - vertices.start]).tobytes())
        digest.update((scene.index[triangles] - np.int32(vertices.start)).tobytes())
        for column in (scene.position, scene.normal, scene.uv, scene.color):
            digest.update(column[vertices].tobytes())
        if len(scene.emissive_uv):
            digest.update(scene.emissive_uv[vertices].tobytes())
    return digest.digest()


def _materials(scene: Scene) -> list[bytes]:
    textures = []
    for x in range(len(scene.texture_byte) - 1):
        data = scene.texture_data[scene.texture_byte[x] : scene.texture_byte[x + 1]]
        how = [*scene.texture_wrap[x], scene.texture_linear[x], scene.texture_smooth[x]]
        textures.append(hashlib.sha256(data.tobytes() + np.array(how, np.int64).tobytes()).digest())
    out = []
    for k in range(len(scene.material_base_color)):
        digest = hashlib.sha256()
        for name in ("base_color", "emissive", "unlit", "alpha_mode", "alpha_cutoff", "double_sided"):
            digest.update(getattr(scene, f"material_{name}")[k].tobytes())
        for x in (scene.material_texture[k], scene.material_emissive_texture[k]):
            digest.update(textures[x] if x >= 0 else b"none")
        out.append(digest.digest())
    return out
