"""Slow, obvious views of geometry and of baked layers: one ray a pixel, no rasteriser."""

import numpy as np
from farfield.bake.model import BakedLayers
from farfield.scene.model import Scene


def triangles(scene: Scene, objects: range) -> np.ndarray:
    """Return (T,3,3) f64: the corners of these objects' triangles."""
    out = []
    for o in objects:
        m = scene.object_matrix[o]
        first, last = scene.mesh_primitive[scene.object_mesh[o]], scene.mesh_primitive[scene.object_mesh[o] + 1]
        index = scene.index[scene.primitive_triangle[first] : scene.primitive_triangle[last]]
        out.append(scene.position[index].astype(np.float64) @ m[:, :3].T + m[:, 3])
    return np.concatenate(out)


def first_hits(corners: np.ndarray, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return (R,) the least s > 0 with eye + s ray on a triangle, infinity if none."""
    best = np.full(len(rays), np.inf)
    for a, b, c in corners:
        u, v, w = b - a, c - a, eye - a
        p = np.cross(rays, v)
        det = p @ u
        q = np.cross(w, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y, s = p @ w / det, rays @ q / det, float(v @ q) / det
        hit = (det != 0) & (x >= 0) & (y >= 0) & (x + y <= 1) & (s > 0)
        best = np.where(hit & (s < best), s, best)
    return best


def layer_texels(baked: BakedLayers, layer: int) -> np.ndarray:
    """Return (h,w,4) u1, rows from low to high."""
    t = baked.tile[layer]
    w, h = baked.tile_size[t]
    return baked.tile_data[baked.tile_byte[t] : baked.tile_byte[t + 1]].reshape(h, w, 4)


def layer_hits(baked: BakedLayers, impostor: int, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return (R,4) u1: of the set texels that each ray from `eye` meets, that of the nearest layer; 0 if none."""
    out = np.zeros((len(rays), 4), np.uint8)
    right, up = baked.right[impostor], baked.up[impostor]
    back = np.cross(right, up)
    start, along = eye - baked.eye[impostor], rays
    for k in range(baked.layer_row[impostor], baked.layer_row[impostor + 1]):
        texels = layer_texels(baked, k)
        height, width = texels.shape[:2]
        z0, z1 = -float(start @ back), -(along @ back)
        s = (baked.plane[k] - z0) / z1
        point = start + s[:, None] * along
        slope = np.stack([point @ right, point @ up], -1) / baked.plane[k]
        at = np.floor((slope - baked.slope0[impostor]) / baked.texel[impostor]).astype(int) - baked.tile_at[k]
        ok = (s > 0) & (at >= 0).all(1) & (at[:, 0] < width) & (at[:, 1] < height)
        ok &= out[:, 3] == 0
        seen = texels[at[ok, 1], at[ok, 0]]
        out[ok] = np.where(seen[:, 3:] > 0, seen, 0)
    return out


def distances(baked: BakedLayers, layer: int) -> np.ndarray:
    """Return (h,w) the distance from the eye's plane that alpha stands for; infinity where empty."""
    alpha = layer_texels(baked, layer)[..., 3].astype(float)
    near, far = 1 / baked.near[layer], 1 / baked.far[layer]
    return np.where(alpha > 0, 1 / (far + (np.maximum(alpha, 1) - 1) // 4 / 62 * (near - far)), np.inf)


def shares(baked: BakedLayers, layer: int) -> np.ndarray:
    """Return (h,w) the share of each texel that is drawn: 0, or a quarter to 1."""
    alpha = layer_texels(baked, layer)[..., 3].astype(int)
    return np.where(alpha > 0, ((alpha - 1) % 4 + 1) / 4, 0.0)
