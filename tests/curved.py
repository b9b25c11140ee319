"""A small level of curved meshes, for tests of the levels of detail: balls in rows, a statue, a hill under them.

Balls come smooth and shaded flat, mirrored and stretched; the hill and the balls are worth simplifying, the posts not.
"""

import numpy as np
from levels import BOX_CORNERS, BOX_FACES, Gltf


def ball(rings: int = 24, *, bumps: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (V,3) f32 and triangles (T,3) of a closed ball of radius about 1."""
    u, v = np.meshgrid(np.arange(2 * rings), np.arange(1, rings), indexing="ij")
    a, b = u * np.pi / rings, v * np.pi / rings
    r = 1 + bumps * np.sin(5 * a) * np.sin(4 * b)
    ring = np.stack([r * np.cos(a) * np.sin(b), r * np.cos(b), r * np.sin(a) * np.sin(b)], -1).reshape(-1, 3)
    position = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]).astype(np.float32)
    at = lambda i, j: (i % (2 * rings)) * (rings - 1) + j  # noqa: E731
    faces = []
    for i in range(2 * rings):
        for j in range(rings - 2):
            faces += [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        faces += [[len(ring), at(i + 1, 0), at(i, 0)], [len(ring) + 1, at(i, rings - 2), at(i + 1, rings - 2)]]
    return position, np.array(faces)


def hill(n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and triangles of a heightfield over [-1, 1]^2."""
    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    y = 0.05 * np.cos(3 * x) * np.cos(2 * z) - 0.05
    position = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    k = i * n + j
    return position, np.concatenate([np.stack([k, k + 1, k + n + 1], 1), np.stack([k, k + n + 1, k + n], 1)])


def curved_level(rows: int = 6, *, far_m: float = 120.0) -> bytes:
    """Return a GLB: rows of balls from z = -20 to -far_m, seen from around the origin; y up, metres."""
    g = Gltf()
    g.add("materials", {"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.2, 0.1, 1]}})
    g.add("materials", {"name": "grey", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}})
    smooth, faces = ball()
    bumpy, bumpy_faces = ball(16, bumps=0.2)
    ground, ground_faces = hill()
    meshes = [
        g.mesh(g.primitive(smooth, faces.astype(np.uint16), material=0, NORMAL=smooth)),
        g.mesh(g.primitive(bumpy, bumpy_faces.astype(np.uint16), material=1)),  # without normals: shaded flat
        g.mesh(  # two primitives
            g.primitive(smooth * 0.5, faces.astype(np.uint16), material=1, NORMAL=smooth),
            g.primitive(bumpy * 0.4 + [0, 1, 0], bumpy_faces.astype(np.uint16), material=0),
        ),
        g.mesh(g.primitive(BOX_CORNERS - [0.5, 0, 0.5], BOX_FACES, material=1)),
    ]
    for r, z in enumerate(np.linspace(-20, -far_m, rows)):
        for c in range(-3, 4):
            mesh = meshes[(r + c) % 4]
            scale = [(1, 1, 1), (-1, 1, 1), (1.5, 0.5, 3), (2, 2, 2)][(r + 2 * c) % 4]
            turn = 0.3 * (r + c)
            rotation = [0, float(np.sin(turn)), 0, float(np.cos(turn))]
            at = [float(5 * c), 1.5, float(z)]
            g.node(name=f"{r} {c}", mesh=mesh, translation=at, rotation=rotation, scale=[float(s) for s in scale])
    size = far_m * 0.75
    land = g.mesh(g.primitive(ground, ground_faces.astype(np.uint16), material=1))
    g.node(name="hill", mesh=land, translation=[0.0, -1.0, -far_m / 2], scale=[size, size, size])
    return g.glb()


SETTINGS = """
budget = "{budget}"
[view_space]
cell_m = 8.0
boxes = [[[-12.0, 1.0, -8.0], [12.0, 2.5, 8.0]]]
[camera]
fov_deg = 45.0
width = 640
height = 360
[detail]
mode = "{mode}"
"""
