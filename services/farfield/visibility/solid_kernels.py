"""Kernels of solids: exact orientation, welding and edges. `solids.py` documents and checks.

`orient2d` is exact for finite input whose products neither overflow nor fall below 1e-290: a filter (Shewchuk 1997,
3.33e-16 of the two products' sum), then all six products of the determinant as an expansion.
"""

import numpy as np
from numba import njit

_FILTER = 3.3306690738754716e-16  # (3 + 16 u) u, u = 2**-53
_SPLIT = 134217729.0  # 2**27 + 1


@njit(cache=True)
def _low_part(a, b, p):
    """a b - p exactly, p = fl(a b) (Dekker)."""
    t = _SPLIT * a
    ah = t - (t - a)
    t = _SPLIT * b
    bh = t - (t - b)
    al, bl = a - ah, b - bh
    return al * bl - (((p - ah * bh) - al * bh) - ah * bl)


@njit(cache=True)
def _grow(expansion, n, value):
    """Add `value` to a non-overlapping expansion of n terms, smallest first; return the new length."""
    q = value
    for i in range(n):
        s = q + expansion[i]
        bb = s - q
        expansion[i] = (q - (s - bb)) + (expansion[i] - bb)
        q = s
    expansion[n] = q
    return n + 1


@njit(cache=True)
def _orient2d_exact(ax, ay, bx, by, cx, cy):
    expansion = np.zeros(12)
    n = 0
    for k in range(6):
        if k == 0:
            u, v = ax, by
        elif k == 1:
            u, v = -ax, cy
        elif k == 2:
            u, v = -cx, by
        elif k == 3:
            u, v = -ay, bx
        elif k == 4:
            u, v = ay, cx
        else:
            u, v = cy, bx
        p = u * v
        n = _grow(expansion, n, _low_part(u, v, p))
        n = _grow(expansion, n, p)
    for i in range(n - 1, -1, -1):
        if expansion[i] != 0.0:
            return 1 if expansion[i] > 0.0 else -1
    return 0


@njit(cache=True)
def orient2d(ax, ay, bx, by, cx, cy):
    """Sign of (a - c) x (b - c): 1 where a, b, c turn left, 0 exactly in line."""
    if (ax == bx and ay == by) or (bx == cx and by == cy) or (ax == cx and ay == cy):
        return 0
    left, right = (ax - cx) * (by - cy), (ay - cy) * (bx - cx)
    det, bound = left - right, _FILTER * (abs(left) + abs(right))
    if det > bound:
        return 1
    if -det > bound:
        return -1
    return _orient2d_exact(ax, ay, bx, by, cx, cy)


@njit(cache=True)
def mix(h, word):
    h = (h ^ word) * np.uint64(0x9E3779B97F4A7C15)
    return h ^ (h >> np.uint64(29))


@njit(cache=True)
def weld(position, number):
    """Number bit-equal positions (V,3) f64 alike, in order of first use; return how many there are."""
    size = 8
    while size < 2 * len(position):
        size *= 2
    table = np.full(size, -1, dtype=np.int32)
    first = np.empty(len(position), dtype=np.int32)
    bits = position.view(np.uint64)
    n = 0
    for i in range(len(position)):
        h = np.uint64(0)
        for axis in range(3):
            h = mix(h, bits[i, axis])
        slot = np.int64(h & np.uint64(size - 1))
        while True:
            k = table[slot]
            if k < 0:
                table[slot], first[n], number[i] = n, i, n
                n += 1
                break
            j = first[k]
            if bits[j, 0] == bits[i, 0] and bits[j, 1] == bits[i, 1] and bits[j, 2] == bits[i, 2]:
                number[i] = k
                break
            slot = (slot + 1) & (size - 1)
    return n


@njit(cache=True)
def edges(triangle, edge, low, high, uses, direction):
    """Number the undirected edges of triangles (T,3) i32; return how many there are.

    edge       (T,3) i32  out: edge from corner k to k + 1
    low, high  (3T,) i32  out: its two vertices, low < high
    uses       (3T,) i32  out: how many triangles use it
    direction  (3T,) i32  out: uses from low to high minus uses from high to low
    """
    size = 8
    while size < 6 * len(triangle):
        size *= 2
    table = np.full(size, -1, dtype=np.int32)
    n = 0
    for t in range(len(triangle)):
        for k in range(3):
            a, b = triangle[t, k], triangle[t, (k + 1) % 3]
            turn = 1
            if a > b:
                a, b, turn = b, a, -1
            h = mix(mix(np.uint64(0), np.uint64(a)), np.uint64(b))
            slot = np.int64(h & np.uint64(size - 1))
            while True:
                e = table[slot]
                if e < 0:
                    e = n
                    table[slot], low[e], high[e], uses[e], direction[e] = e, a, b, 0, 0
                    n += 1
                    break
                if low[e] == a and high[e] == b:
                    break
                slot = (slot + 1) & (size - 1)
            edge[t, k] = e
            uses[e] += 1
            direction[e] += turn
    return n


@njit(cache=True)
def root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def connect(edge, n_edges, group):
    """Number the triangles' groups that hang together by edges (T,) i32, in order of the first triangle; return count."""
    parent = np.arange(len(edge), dtype=np.int32)
    owner = np.full(n_edges, -1, dtype=np.int32)
    for t in range(len(edge)):
        for k in range(3):
            e = edge[t, k]
            if owner[e] < 0:
                owner[e] = t
            else:
                a, b = root(parent, t), root(parent, owner[e])
                if a != b:
                    parent[max(a, b)] = min(a, b)
    n = 0
    for t in range(len(edge)):
        r = root(parent, t)
        if r == t:
            group[t] = n
            n += 1
        else:
            group[t] = group[r]
    return n


@njit(cache=True)
def facing(vertex, triangle, up):
    """up (T,) i8: 1 where the front of a triangle looks up (+y), -1 down, 0 where it is exactly vertical."""
    for t in range(len(triangle)):
        a, b, c = vertex[triangle[t, 0]], vertex[triangle[t, 1]], vertex[triangle[t, 2]]
        up[t] = -orient2d(a[0], a[2], b[0], b[2], c[0], c[2])
