"""Kernels of stage scene; `level.py` and `derive.py` document and check. Fixed order, no fused sums of other shapes."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def solid_triangles(position, index, keep):
    """Mark triangles with area: corners that differ and are not exactly in line, in float64 of the float32 corners."""
    for t in range(len(index)):
        ax, ay, az = position[index[t, 0]]
        bx, by, bz = position[index[t, 1]]
        cx, cy, cz = position[index[t, 2]]
        ux, uy, uz = np.float64(bx) - ax, np.float64(by) - ay, np.float64(bz) - az
        vx, vy, vz = np.float64(cx) - ax, np.float64(cy) - ay, np.float64(cz) - az
        keep[t] = (uy * vz != uz * vy) or (uz * vx != ux * vz) or (ux * vy != uy * vx)


@njit(cache=True)
def face_normals(position, index, normal):
    """Unit normals (T,3) f64 of triangles with area."""
    for t in range(len(index)):
        ax, ay, az = position[index[t, 0]]
        bx, by, bz = position[index[t, 1]]
        cx, cy, cz = position[index[t, 2]]
        ux, uy, uz = np.float64(bx) - ax, np.float64(by) - ay, np.float64(bz) - az
        vx, vy, vz = np.float64(cx) - ax, np.float64(cy) - ay, np.float64(cz) - az
        # A power of two, so that what had area keeps it; float32 corners may lie 1e-30 or 1e30 apart.
        scale = math.ldexp(1.0, -math.frexp(max(abs(ux), abs(uy), abs(uz), abs(vx), abs(vy), abs(vz)))[1])
        ux, uy, uz, vx, vy, vz = ux * scale, uy * scale, uz * scale, vx * scale, vy * scale, vz * scale
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        largest = max(abs(nx), abs(ny), abs(nz))
        nx, ny, nz = nx / largest, ny / largest, nz / largest
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        normal[t, 0], normal[t, 1], normal[t, 2] = nx / length, ny / length, nz / length


@njit(cache=True)
def object_boxes(position, vertex_start, vertex_stop, mesh, matrix, box):
    """Boxes of placed meshes: each vertex as ((m0 x + m1 y) + m2 z) + m3 in float64."""
    for o in range(len(mesh)):
        for axis in range(3):
            box[o, 0, axis], box[o, 1, axis] = np.inf, -np.inf
        for i in range(vertex_start[mesh[o]], vertex_stop[mesh[o]]):
            x, y, z = np.float64(position[i, 0]), np.float64(position[i, 1]), np.float64(position[i, 2])
            for axis in range(3):
                m = matrix[o, axis]
                p = ((m[0] * x + m[1] * y) + m[2] * z) + m[3]
                box[o, 0, axis] = min(box[o, 0, axis], p)
                box[o, 1, axis] = max(box[o, 1, axis], p)


@njit(cache=True)
def place(position, matrix, out):
    """Positions (V,3) f32 through a (3,4) f64 matrix."""
    for i in range(len(position)):
        x, y, z = np.float64(position[i, 0]), np.float64(position[i, 1]), np.float64(position[i, 2])
        for axis in range(3):
            m = matrix[axis]
            out[i, axis] = ((m[0] * x + m[1] * y) + m[2] * z) + m[3]


@njit(cache=True)
def lowest_surface(corner, facing, steepest, floor_y, x0, z0, step, height):
    """Lower `height` (nx,nz) to the lowest surface over each sample point.

    corner    (T,3,3) f64 placed triangles
    facing    1: those whose normal points up, -1: down
    steepest  least |normal y| of a unit normal that counts
    floor_y   surfaces below it do not count
    Sample (i, k) stands at (x0 + i step, z0 + k step).
    """
    nx, nz = height.shape
    for t in range(len(corner)):
        ax, ay, az = corner[t, 0]
        ux, uy, uz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
        vx, vy, vz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
        normal_x, normal_y, normal_z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(normal_x * normal_x + normal_y * normal_y + normal_z * normal_z)
        if not normal_y * facing > steepest * length:
            continue
        low_x, high_x = ax + min(0.0, ux, vx), ax + max(0.0, ux, vx)
        low_z, high_z = az + min(0.0, uz, vz), az + max(0.0, uz, vz)
        i0 = int(np.ceil(min(max((low_x - x0) / step, 0.0), float(nx))))
        i1 = int(np.floor(max(min((high_x - x0) / step, nx - 1.0), -1.0)))
        k0 = int(np.ceil(min(max((low_z - z0) / step, 0.0), float(nz))))
        k1 = int(np.floor(max(min((high_z - z0) / step, nz - 1.0), -1.0)))
        for i in range(i0, i1 + 1):
            px = x0 + i * step - ax
            for k in range(k0, k1 + 1):
                pz = z0 + k * step - az
                # normal_y is minus the determinant of (u, v) in x and z.
                s = (vx * pz - vz * px) / normal_y
                r = (uz * px - ux * pz) / normal_y
                if s >= 0.0 and r >= 0.0 and s + r <= 1.0:
                    y = ay + s * uy + r * vy
                    if y >= floor_y and y < height[i, k]:
                        height[i, k] = y
