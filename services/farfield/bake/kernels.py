"""From a cluster's triangles to snapped pieces inside slabs. Private: `farfield.bake.clip` checks, this computes.

A border point is computed from the two ends of the original edge, lower z first, whichever slab or triangle asks: both
slabs at a border, and both triangles at an edge, get the same float64 point and so the same snapped one.
"""

import math

import numpy as np
from numba import njit

SNAP = 256


@njit(cache=True)
def _to_frame(v, m, eye, axes, out):
    x, y, z = float(v[0]), float(v[1]), float(v[2])
    wx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - eye[0]
    wy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - eye[1]
    wz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - eye[2]
    for a in range(3):
        out[a] = axes[a, 0] * wx + axes[a, 1] * wy + axes[a, 2] * wz


@njit(cache=True)
def gather(position, index, primitive_triangle, primitive_material, mesh_primitive, object_mesh, object_matrix, start, stop,
           first, last, skip, single, eye, axes, hull, directions, corner, vertex, material, owner, away):  # fmt: skip
    """Fill the triangles [first, last) of those of objects [start, stop) in frame coordinates; return how many. What no
    point of the view cell (hull points and directions, relative to the eye, in the frame) sees from its front is
    culled if single-sided, else `away` where the eye sees its back, too."""
    n, passed = 0, 0
    for o in range(start, stop):
        m = object_matrix[o]
        det = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        )
        mesh = object_mesh[o]
        for p in range(mesh_primitive[mesh], mesh_primitive[mesh + 1]):
            k, t0, t1 = primitive_material[p], primitive_triangle[p], primitive_triangle[p + 1]
            here = passed
            passed += t1 - t0
            if skip[k] or passed <= first or here >= last:
                continue
            for t in range(t0 + max(first - here, 0), min(t1, t0 + last - here)):
                for c in range(3):
                    vertex[n, c] = index[t, c]
                    _to_frame(position[index[t, c]], m, eye, axes, corner[n, c])
                a0, a1, a2 = corner[n, 0], corner[n, 1], corner[n, 2]
                ux, uy, uz = a1[0] - a0[0], a1[1] - a0[1], a1[2] - a0[2]
                vx, vy, vz = a2[0] - a0[0], a2[1] - a0[1], a2[2] - a0[2]
                # z points away from the eye, so the frame is left-handed: the outward normal is v x u
                nx, ny, nz = vy * uz - vz * uy, vz * ux - vx * uz, vx * uy - vy * ux
                if det < 0:
                    nx, ny, nz = -nx, -ny, -nz
                level = nx * a0[0] + ny * a0[1] + nz * a0[2]
                seen = False
                if single[k] or level > 0:
                    for h in range(len(hull)):
                        if nx * hull[h, 0] + ny * hull[h, 1] + nz * hull[h, 2] >= level:
                            seen = True
                            break
                    for h in range(len(directions)):
                        if seen or nx * directions[h, 0] + ny * directions[h, 1] + nz * directions[h, 2] > 0:
                            seen = True
                            break
                    if single[k] and not seen:
                        continue
                material[n] = k
                owner[n] = o - start
                away[n] = level > 0 and not seen
                n += 1
    return n


@njit(cache=True)
def snap(x, slope0, texel, side):
    """Return the slope x in whole 1/256 texels, clamped to the grid: rounding may put a corner of the box outside."""
    s = math.floor((x - slope0) / texel * SNAP + 0.5)
    return int(min(max(s, 0.0), side * float(SNAP)))


@njit(cache=True)
def snap_sources(corner, vertex, slope0, texel, side, snapped, inverse, reciprocal):
    """Fill snapped corners, 1 / z and edge lengths; turn every triangle counter-clockwise. Return the largest distance
    of a corner from the grid, in texels, or -1 if a corner is not in front of the eye."""
    outside = 0.0
    for s in range(len(corner)):
        for c in range(3):
            z = corner[s, c, 2]
            if not z > 0:
                return -1.0
            for a in range(2):
                slope = corner[s, c, a] / z
                at = (slope - slope0[a]) / texel[a]
                outside = max(outside, -at, at - side[a])
                snapped[s, 2 * c + a] = snap(slope, slope0[a], texel[a], side[a])
        q = snapped[s]
        twice = np.int64(q[2] - q[0]) * np.int64(q[5] - q[1]) - np.int64(q[4] - q[0]) * np.int64(q[3] - q[1])
        if twice < 0:
            vertex[s, 1], vertex[s, 2] = vertex[s, 2], vertex[s, 1]
            for a in range(3):
                corner[s, 1, a], corner[s, 2, a] = corner[s, 2, a], corner[s, 1, a]
            q[2], q[4] = q[4], q[2]
            q[3], q[5] = q[5], q[3]
        for c in range(3):
            inverse[s, c] = 1.0 / corner[s, c, 2]
            d = (c + 1) % 3
            ex, ey = np.int64(q[2 * d] - q[2 * c]), np.int64(q[2 * d + 1] - q[2 * c + 1])
            squared = ex * ex + ey * ey
            reciprocal[s, c] = np.float32(1.0 / squared) if squared > 0 else np.float32(0)
    return outside


@njit(cache=True)
def _cross(p, q, border, out):
    if p[2] > q[2]:
        p, q = q, p
    t = (border - p[2]) / (q[2] - p[2])
    out[0] = p[0] + t * (q[0] - p[0])
    out[1] = p[1] + t * (q[1] - p[1])
    out[2] = border


@njit(cache=True)
def clip(triangle, near, far, out):
    """Fill `out` (9,3) with the corners of triangle within near <= z <= far, in order; return how many (0 if none)."""
    n = 0
    for c in range(3):
        p, q = triangle[c], triangle[(c + 1) % 3]
        if near <= p[2] <= far:
            out[n, 0], out[n, 1], out[n, 2] = p[0], p[1], p[2]
            n += 1
        rising = p[2] < q[2]
        for turn in range(2):
            border = near if rising == (turn == 0) else far
            if min(p[2], q[2]) < border < max(p[2], q[2]):
                _cross(p, q, border, out[n])
                n += 1
    return n


@njit(cache=True)
def _range(triangle, near, far):
    low = min(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    high = max(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    first = np.searchsorted(far, low)  # the first slab whose far end is not nearer than the triangle
    last = np.searchsorted(near, high, side="right") - 1
    return first, last


@njit(cache=True)
def count_pieces(corner, near, far, count):
    """Add up the pieces of each slab; near[0] must be -inf and far[-1] inf."""
    out = np.empty((9, 3))
    for s in range(len(corner)):
        first, last = _range(corner[s], near, far)
        for k in range(first, last + 1):
            if first == last:
                count[k] += 1
            else:
                count[k] += max(1, clip(corner[s], near[k], far[k], out) - 2)


@njit(cache=True)
def fill_pieces(corner, snapped, near, far, slope0, texel, side, place, piece, source):
    """Write the pieces; place[k] is where the next one of slab k goes."""
    out = np.empty((9, 3))
    q = np.empty((9, 2), np.int32)
    for s in range(len(corner)):
        first, last = _range(corner[s], near, far)
        for k in range(first, last + 1):
            if first == last:
                at = place[k]
                for c in range(6):
                    piece[at, c] = snapped[s, c]
                source[at] = s
                place[k] += 1
                continue
            n = clip(corner[s], near[k], far[k], out)
            for c in range(n):
                for a in range(2):
                    q[c, a] = snap(out[c, a] / out[c, 2], slope0[a], texel[a], side[a])
            for f in range(max(1, n - 2)):
                b, c = min(f + 1, n - 1), min(f + 2, n - 1)
                at = place[k]
                piece[at, 0], piece[at, 1] = q[0, 0], q[0, 1]
                piece[at, 2], piece[at, 3] = q[b, 0], q[b, 1]
                piece[at, 4], piece[at, 5] = q[c, 0], q[c, 1]
                source[at] = s
                place[k] += 1


@njit(cache=True)
def bound_pieces(row, piece, side, low, size):
    """Fill the rectangle of texels that the pieces of each layer touch."""
    for k in range(len(row) - 1):
        if row[k] == row[k + 1]:
            low[k, 0], low[k, 1], size[k, 0], size[k, 1] = 0, 0, 0, 0
            continue
        for a in range(2):
            first, last = 2**31 - 1, -1
            for f in range(row[k], row[k + 1]):
                for c in range(3):
                    first = min(first, piece[f, 2 * c + a])
                    last = max(last, piece[f, 2 * c + a])
            first = max(-((-first) // SNAP) - 1, 0)  # closed: a corner on a texel's edge touches both
            last = min(last // SNAP, side[a] - 1)
            low[k, a], size[k, a] = first, last - first + 1


@njit(cache=True)
def snap_corners(corner, slope0, texel, side, snapped):
    """Fill the snapped corners of triangles that lie in front of the eye."""
    for s in range(len(corner)):
        for c in range(3):
            for a in range(2):
                snapped[s, 2 * c + a] = snap(corner[s, c, a] / corner[s, c, 2], slope0[a], texel[a], side[a])


@njit(cache=True)
def _keep_side(polygon, n, axis, sign, border, out):
    """Clip polygon (n corners) to sign * x[axis] <= sign * border; return how many corners `out` gets."""
    m = 0
    for c in range(n):
        p, q = polygon[c], polygon[(c + 1) % n]
        a, b = sign * (border - p[axis]), sign * (border - q[axis])
        if a >= 0:
            out[m] = p
            m += 1
        if (a > 0 and b < 0) or (a < 0 and b > 0):
            for d in range(3):
                out[m, d] = p[d] + a / (a - b) * (q[d] - p[d])
            out[m, axis] = border
            m += 1
    return m


@njit(cache=True)
def gather_inside(position, index, primitive_triangle, mesh_primitive, primitive_vertex, object_mesh, object_matrix,
                  objects, first, last, low, high, eye, axes, corner):  # fmt: skip
    """Fill the triangles [first, last) of those of these objects, clipped to a box, in frame coordinates; return how many.
    Corner must hold seven for each. The box must lie in front of the eye."""
    n, passed = 0, 0
    world, other = np.empty((9, 3)), np.empty((9, 3))
    for o in objects:
        m, mesh = object_matrix[o], object_mesh[o]
        for p in range(mesh_primitive[mesh], mesh_primitive[mesh + 1]):
            t0, t1, here = primitive_triangle[p], primitive_triangle[p + 1], passed
            passed += t1 - t0
            for t in range(t0 + max(first - here, 0), min(t1, t0 + last - here)):
                outside = False
                for a in range(3):
                    least, most = np.inf, -np.inf
                    for c in range(3):
                        v = position[index[t, c]]
                        x = m[a, 0] * v[0] + m[a, 1] * v[1] + m[a, 2] * v[2] + m[a, 3]
                        world[c, a] = x
                        least, most = min(least, x), max(most, x)
                    outside = outside or least > high[a] or most < low[a]
                if outside:
                    continue
                count = 3
                for a in range(3):
                    count = _keep_side(world, count, a, 1.0, high[a], other)
                    count = _keep_side(other, count, a, -1.0, low[a], world)
                for f in range(1, count - 1):
                    for c in range(3):
                        w = world[0] if c == 0 else world[f + c - 1]
                        for a in range(3):
                            corner[n, c, a] = (
                                axes[a, 0] * (w[0] - eye[0])
                                + axes[a, 1] * (w[1] - eye[1])
                                + axes[a, 2] * (w[2] - eye[2])
                            )
                    n += 1
    return n
