"""Kernels of patches; `patches.py` documents and checks."""

import numpy as np
from numba import njit

from farfield.visibility.solid_kernels import mix, root

_FLAT = 1.0 - 1e-8  # cosine between neighbours that may join
_REFLEX = -1e-5  # sine of the deepest notch in an outline
_MARGIN = 2.0**-45


@njit(cache=True)
def _bend(vertex, a, b, c, d, n):
    """Sine-like measure of the turn from edge a -> b to edge c -> d about n."""
    ux, uy, uz = vertex[b, 0] - vertex[a, 0], vertex[b, 1] - vertex[a, 1], vertex[b, 2] - vertex[a, 2]
    vx, vy, vz = vertex[d, 0] - vertex[c, 0], vertex[d, 1] - vertex[c, 1], vertex[d, 2] - vertex[c, 2]
    cross = (uy * vz - uz * vy) * n[0] + (uz * vx - ux * vz) * n[1] + (ux * vy - uy * vx) * n[2]
    size = np.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
    return cross / size if size > 0.0 else 0.0


@njit(cache=True)
def join(vertex, triangle, normal, two_sided, next_, face):
    """Join triangles across common edges, longest first, while flat and convex.

    Half edge h = 3 t + k runs from corner k of triangle t to k + 1; next_[h] is the next of its outline, -1 where it
    was joined across. face[t] is the least triangle that t was joined with.
    """
    m = 3 * len(triangle)
    size = 8
    while size < 2 * m:
        size *= 2
    table = np.full(size, -1, dtype=np.int32)
    previous = np.empty(m, np.int32)
    twin = np.full(m, -1, np.int32)
    uses = np.zeros(m, np.int32)
    length = np.zeros(m)
    for h in range(m):
        t, k = h // 3, h % 3
        next_[h], previous[h] = 3 * t + (k + 1) % 3, 3 * t + (k + 2) % 3
        a, b = triangle[t, k], triangle[t, (k + 1) % 3]
        slot = np.int64(mix(mix(np.uint64(0), np.uint64(min(a, b))), np.uint64(max(a, b))) & np.uint64(size - 1))
        while True:
            g = table[slot]
            if g < 0:
                table[slot] = h
                uses[h] = 1
                break
            c, d = triangle[g // 3, g % 3], triangle[g // 3, (g % 3 + 1) % 3]
            if min(a, b) == min(c, d) and max(a, b) == max(c, d):
                uses[g] += 1
                if uses[g] == 2 and a == d and b == c:
                    twin[g] = h
                    length[g] = (
                        (vertex[a, 0] - vertex[b, 0]) ** 2
                        + (vertex[a, 1] - vertex[b, 1]) ** 2
                        + (vertex[a, 2] - vertex[b, 2]) ** 2
                    )
                break
            slot = (slot + 1) & (size - 1)
    parent = np.arange(len(triangle), dtype=np.int32)
    for h in np.argsort(-length, kind="mergesort"):
        g = twin[h]
        if g < 0 or uses[h] != 2:
            continue
        s, t = h // 3, g // 3
        n = normal[s]
        if n[0] * normal[t, 0] + n[1] * normal[t, 1] + n[2] * normal[t, 2] < _FLAT or two_sided[s] != two_sided[t]:
            continue
        a, b = root(parent, s), root(parent, t)
        if a == b:
            continue
        ph, nh, pg, ng = previous[h], next_[h], previous[g], next_[g]
        u, v = triangle[s, h % 3], triangle[s, (h % 3 + 1) % 3]
        before_u, after_u = triangle[ph // 3, ph % 3], triangle[ng // 3, (ng % 3 + 1) % 3]
        before_v, after_v = triangle[pg // 3, pg % 3], triangle[nh // 3, (nh % 3 + 1) % 3]
        if _bend(vertex, before_u, u, u, after_u, n) < _REFLEX or _bend(vertex, before_v, v, v, after_v, n) < _REFLEX:
            continue
        next_[ph], previous[ng] = ng, ph
        next_[pg], previous[nh] = nh, pg
        next_[h], next_[g] = -1, -1
        parent[max(a, b)] = min(a, b)
    for t in range(len(triangle)):
        face[t] = root(parent, t)


@njit(cache=True)
def _planes(low, high, first, last, edge, sign, plane, bound):
    """Fill plane[(last - first) * 8] (x, y, z, w): a target point b is behind the patch where all are < -bound * |b - u|.

    sign  1: A is in front. bound is of each edge.
    """
    n = 0
    for e in range(first, last):
        u, v = edge[e, 0], edge[e, 1]
        dx, dy, dz = v[0] - u[0], v[1] - u[1], v[2] - u[2]
        length = max(abs(dx), abs(dy), abs(dz))
        reach = 0.0
        for axis in range(3):
            reach = max(reach, abs(low[axis] - u[axis]), abs(high[axis] - u[axis]))
        for c in range(8):
            ax = (high[0] if c & 1 else low[0]) - u[0]
            ay = (high[1] if c & 2 else low[1]) - u[1]
            az = (high[2] if c & 4 else low[2]) - u[2]
            plane[n, 0] = sign * (dy * az - dz * ay)
            plane[n, 1] = sign * (dz * ax - dx * az)
            plane[n, 2] = sign * (dx * ay - dy * ax)
            n += 1
        bound[e - first] = _MARGIN * length * reach
    return n


@njit(cache=True)
def _behind(to_low, to_high, first, last, edge, plane, bound, offset):
    for e in range(first, last):
        u = edge[e, 0]
        mx, my, mz = (
            0.5 * (to_low[0] + to_high[0]) - u[0],
            0.5 * (to_low[1] + to_high[1]) - u[1],
            0.5 * (to_low[2] + to_high[2]) - u[2],
        )
        hx, hy, hz = 0.5 * (to_high[0] - to_low[0]), 0.5 * (to_high[1] - to_low[1]), 0.5 * (to_high[2] - to_low[2])
        s = max(abs(mx) + hx, abs(my) + hy, abs(mz) + hz)
        margin = bound[e - first] * s
        for c in range(8):
            p = plane[offset + 8 * (e - first) + c]
            if (p[0] * mx + p[1] * my + p[2] * mz) + (abs(p[0]) * hx + abs(p[1]) * hy + abs(p[2]) * hz) >= -margin:
                return False
    return True


@njit(cache=True)
def hide(low, high, objects, object_box, row, edge, normal, span, two_sided, slack, hidden):
    """Set hidden[j] where one patch hides the box of objects[j] (ascending ids) from box [low, high].

    slack  metres that bound the rounding of distances along a direction
    """
    n_patches = len(row) - 1
    usable = np.empty(n_patches, np.int64)
    side = np.empty(n_patches)
    start = np.empty(n_patches, np.int64)
    n, total = 0, 0
    for p in range(n_patches):
        d, r = 0.0, 0.0
        for axis in range(3):
            d += normal[p, axis] * 0.5 * (low[axis] + high[axis])
            r += abs(normal[p, axis]) * 0.5 * (high[axis] - low[axis])
        if d - r > span[p, 1] + slack:
            side[n] = 1.0
        elif d + r < span[p, 0] - slack and two_sided[p]:
            side[n] = -1.0
        else:
            continue
        usable[n], start[n] = p, total
        total += row[p + 1] - row[p]
        n += 1
    plane, bound = np.empty((8 * total, 4)), np.empty(total)
    for i in range(n):
        p = usable[i]
        _planes(low, high, row[p], row[p + 1], edge, side[i], plane[8 * start[i] :], bound[start[i] :])
    m = 1
    while m < len(objects):
        m *= 2
    box = np.empty((2 * m, 2, 3))
    for j in range(m):
        if j < len(objects):
            box[m + j] = object_box[objects[j]]
        else:
            for axis in range(3):
                box[m + j, 0, axis], box[m + j, 1, axis] = np.inf, -np.inf
    for node in range(m - 1, 0, -1):
        for axis in range(3):
            box[node, 0, axis] = min(box[2 * node, 0, axis], box[2 * node + 1, 0, axis])
            box[node, 1, axis] = max(box[2 * node, 1, axis], box[2 * node + 1, 1, axis])
    whole = np.zeros(2 * m, np.bool_)
    for node in range(1, 2 * m):
        if box[node, 0, 0] > box[node, 1, 0]:
            continue
        if node > 1 and whole[node // 2]:
            whole[node] = True
        else:
            for i in range(n):
                p = usable[i]
                d, r = 0.0, 0.0
                for axis in range(3):
                    d += normal[p, axis] * 0.5 * (box[node, 0, axis] + box[node, 1, axis])
                    r += abs(normal[p, axis]) * 0.5 * (box[node, 1, axis] - box[node, 0, axis])
                if side[i] > 0.0 and d + r >= span[p, 0] - slack:
                    continue
                if side[i] < 0.0 and d - r <= span[p, 1] + slack:
                    continue
                if _behind(
                    box[node, 0], box[node, 1], row[p], row[p + 1], edge, plane, bound[start[i] :], 8 * start[i]
                ):
                    whole[node] = True
                    break
        if whole[node] and node >= m:
            hidden[node - m] = True
