"""Frusta the slow way: visibility by clipping, separating axes by trying every pair of rays."""

import numpy as np
from farfield.geometry.camera import Camera, camera_frame
from naive.rendertime import FACES, corners, screen_points


def sees(box, eye, direction, camera: Camera) -> bool:
    """Does the camera have a part of the box on its screen? By clipping the box's faces to the view pyramid."""
    if ((box[0] <= eye) & (eye <= box[1])).all():
        return True
    local = (corners(box) - eye) @ np.array(camera_frame(direction)).T
    return any(screen_points([local[i] for i in face], *camera.half_tan) for face in FACES)


def cone_normals(rays):
    """Unit normals, inwards, of all planes that can separate the cone of a few rays from an axis-aligned box."""
    rays = [np.asarray(r) / np.linalg.norm(r) for r in rays]
    found = []
    for k, a in enumerate(rays):
        for b in [*rays[k + 1 :], *np.eye(3)]:
            found += [np.cross(a, b), np.cross(b, a)]
    found += [*np.eye(3), *-np.eye(3)]
    normals = []
    for normal in found:
        if np.linalg.norm(normal) < 1e-9:
            continue
        normal = normal / np.linalg.norm(normal)
        if all(normal @ r >= -1e-12 for r in rays):
            normals.append(normal)
    return normals


def accepts(normals, pad, box, cell) -> bool:
    """Steps 3 and 4 of error-metric.md section 10, one box, plain loops."""
    q = [(box[0][k] + box[1][k] - (cell[0][k] + cell[1][k])) / 2 for k in range(3)]
    g = [(box[1][k] - box[0][k] + (cell[1][k] - cell[0][k])) / 2 for k in range(3)]
    reach = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]) + np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    for n in normals:
        middle = n[0] * q[0] + n[1] * q[1] + n[2] * q[2]
        if middle + (abs(n[0]) * g[0] + abs(n[1]) * g[1] + abs(n[2]) * g[2]) + pad * reach < 0:
            return False
    return True
