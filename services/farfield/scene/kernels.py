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
def row_reach(point, low, high, x0, step, reach):
    """Widen reach (nx,2), least and largest z a row, by the points (V,3) f64 in the rectangle from low to high."""
    for i in range(len(point)):
        x, z = point[i, 0], point[i, 2]
        if x >= low[0] and x <= high[0] and z >= low[2] and z <= high[2]:
            row = min(max(int(np.floor((x - x0) / step + 0.5)), 0), len(reach) - 1)
            reach[row, 0] = min(reach[row, 0], z)
            reach[row, 1] = max(reach[row, 1], z)


@njit(cache=True)
def lowest_surface(corner, facing, steepest, floor_y, x0, z0, step, height, most=1 << 62):
    """Lower `height` (nx,nz) to the lowest surface over each sample point; return how many it looked at, above `most`: gave up.

    corner    (T,3,3) f64 placed triangles
    facing    1: those whose normal points up, -1: down
    steepest  least |normal y| of a unit normal that counts
    floor_y   surfaces below it do not count
    Sample (i, k) stands at (x0 + i step, z0 + k step).
    """
    nx, nz = height.shape
    looked = 0
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
        looked += max(0, i1 + 1 - i0) * max(0, k1 + 1 - k0)
        if looked > most:
            return looked
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
    return looked


@njit(cache=True)
def corner_vertices(index, missing, face_side, corner):
    """Give each corner its own vertex where faces of different sides meet; return (source (V',), side (V',) of each).

    index      (T,3) old vertices
    missing    (V,) b1: vertices that take the side of the face
    face_side  (T,) i32 > 0, of faces that have such a corner
    corner     (T,3) out: new vertices, in order of old vertex and side; unused ones have none
    """
    n = len(missing)
    start, used = np.zeros(n + 1, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    for t in range(len(index)):
        for k in range(3):
            v = index[t, k]
            if missing[v]:
                start[v + 1] += 1
            else:
                used[v] = True
    for v in range(n):
        start[v + 1] += start[v]
    sides, cursor = np.empty(start[n], dtype=np.int32), start[:-1].copy()
    for t in range(len(index)):
        for k in range(3):
            v = index[t, k]
            if missing[v]:
                sides[cursor[v]] = face_side[t]
                cursor[v] += 1
    first = np.empty(n + 1, dtype=np.int64)
    first[0] = 0
    for v in range(n):
        distinct = int(used[v])
        if start[v + 1] > start[v]:
            here = sides[start[v] : start[v + 1]]
            here.sort()
            for i in range(len(here)):
                if i == 0 or here[i] != here[i - 1]:
                    here[distinct] = here[i]
                    distinct += 1
        first[v + 1] = first[v] + distinct
    source, side = np.empty(first[n], dtype=np.int64), np.zeros(first[n], dtype=np.int32)
    for v in range(n):
        for i in range(first[v], first[v + 1]):
            source[i] = v
            if missing[v]:
                side[i] = sides[start[v] + i - first[v]]
    for t in range(len(index)):
        for k in range(3):
            v = index[t, k]
            at = first[v]
            if missing[v]:
                at += np.searchsorted(sides[start[v] : start[v] + first[v + 1] - at], face_side[t])
            corner[t, k] = at
    return source, side


@njit(cache=True)
def own_vertices(index, triangle, primitive_triangle, n_vertices, corner, primitive_vertex):
    """Give each primitive its own vertices, in the order of the old ones; return source (V',), the old vertex of each.

    Primitive p is triangle[p] .. of index (T,3); corner (T',3) and primitive_vertex (P+1,) are out.
    """
    source = np.empty(3 * len(triangle), dtype=np.int64)
    owner, number = np.full(n_vertices, -1, dtype=np.int32), np.empty(n_vertices, dtype=np.int64)
    at = 0
    primitive_vertex[0] = 0
    for p in range(len(primitive_triangle) - 1):
        first = at
        for i in range(primitive_triangle[p], primitive_triangle[p + 1]):
            for k in range(3):
                v = index[triangle[i], k]
                if owner[v] != p:
                    owner[v] = p
                    source[at] = v
                    at += 1
        source[first:at].sort()
        for i in range(first, at):
            number[source[i]] = i
        for i in range(primitive_triangle[p], primitive_triangle[p + 1]):
            for k in range(3):
                corner[i, k] = number[index[triangle[i], k]]
        primitive_vertex[p + 1] = at
    return source[:at].copy()
