"""From-region visibility the slow way: cells by clipping each box, objects by trying each triangle."""

import numpy as np


def cells_crossed(boxes, origin, direction, back, ahead):
    """Return the indices of closed boxes (C,2,3) that the points origin + t direction, -back <= t <= ahead, meet."""
    out = []
    for i, box in enumerate(boxes):
        low, high = -back, ahead
        for k in range(3):
            if direction[k] == 0:
                if not box[0][k] <= origin[k] <= box[1][k]:
                    low, high = 1.0, 0.0
                continue
            a, b = sorted(((box[0][k] - origin[k]) / direction[k], (box[1][k] - origin[k]) / direction[k]))
            low, high = max(low, a), min(high, b)
        if low <= high:
            out.append(i)
    return out


def first_hit(triangles, origin, direction):
    """Return (index, distance) of the nearest of triangles (T,3,3) along the ray, (-1, inf) for none: Cramer's rule."""
    best, nearest = -1, np.inf
    for i, (a, b, c) in enumerate(np.asarray(triangles, dtype=np.float64)):
        matrix = np.stack([b - a, c - a, -np.asarray(direction)], axis=1)
        if abs(np.linalg.det(matrix)) < 1e-15:
            continue
        u, v, t = np.linalg.solve(matrix, origin - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < nearest:
            best, nearest = i, t
    return best, nearest


def object_triangles(scene):
    """Return (triangles (T,3,3) f64 relative to the scene's origin, object (T,), alpha mode (T,))."""
    corners, objects, modes = [], [], []
    for o, mesh in enumerate(scene.object_mesh):
        matrix = scene.object_matrix[o]
        for p in range(scene.mesh_primitive[mesh], scene.mesh_primitive[mesh + 1]):
            for t in range(scene.primitive_triangle[p], scene.primitive_triangle[p + 1]):
                local = scene.position[scene.index[t]].astype(np.float64)
                corners.append(local @ matrix[:, :3].T + matrix[:, 3])
                objects.append(o)
                modes.append(scene.material_alpha_mode[scene.primitive_material[p]])
    return np.array(corners), np.array(objects), np.array(modes)
