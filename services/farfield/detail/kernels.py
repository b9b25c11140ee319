"""Numba kernels of the error of a level: distances between triangle meshes, bounded from above. float64, fixed order."""

import numpy as np
from numba import njit

LEAF = 4  # triangles of a leaf of the box tree
MOST_DEPTH = 64  # of the box tree: halves, so 2^64 leaves
MOST_CUTS = 48  # of a piece, one after the other


@njit(cache=True, error_model="numpy")
def _segment2(p, a, b):
    """Return the squared distance of p from a point of the segment ab, the nearest but for rounding."""
    length2 = 0.0
    along = 0.0
    for k in range(3):
        length2 += (b[k] - a[k]) * (b[k] - a[k])
        along += (p[k] - a[k]) * (b[k] - a[k])
    t = min(1.0, max(0.0, along / length2)) if length2 > 0 else 0.0
    out = 0.0
    for k in range(3):
        d = p[k] - (a[k] + t * (b[k] - a[k]))
        out += d * d
    return out


@njit(cache=True, error_model="numpy")
def triangle2(p, t):
    """Return the squared distance of p (3,) from a point of triangle t (3,3), the nearest but for rounding.

    It is the distance of some point of the triangle, whatever rounding does: never below the true one.
    """
    a, b, c = t[0], t[1], t[2]
    d00, d01, d11, d20, d21 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, w = b[k] - a[k], c[k] - a[k], p[k] - a[k]
        d00 += u * u
        d01 += u * v
        d11 += v * v
        d20 += w * u
        d21 += w * v
    size = d00 * d11 - d01 * d01
    if size > 0:
        s = (d11 * d20 - d01 * d21) / size
        r = (d00 * d21 - d01 * d20) / size
        if s >= 0 and r >= 0 and s + r <= 1:
            out = 0.0
            for k in range(3):
                d = p[k] - (a[k] + s * (b[k] - a[k]) + r * (c[k] - a[k]))
                out += d * d
            return out
    return min(_segment2(p, a, b), _segment2(p, b, c), _segment2(p, c, a))


@njit(cache=True)
def build_tree(triangles):
    """Return (box (K,2,3), child (K,), span (K,2), order (T,)): halves along the longest side, ties by position.

    triangles (T,3,3) f64, T >= 1. Node k has triangles order[span]; its children are child[k] and child[k] + 1, or -1.
    """
    n = len(triangles)
    most = 2 * n
    box, child, span = np.empty((most, 2, 3)), np.full(most, -1, np.int64), np.empty((most, 2), np.int64)
    order = np.arange(n)
    middle = np.empty((n, 3))
    for t in range(n):
        for k in range(3):
            middle[t, k] = (triangles[t, 0, k] + triangles[t, 1, k] + triangles[t, 2, k]) / 3
    nodes = 1
    span[0, 0], span[0, 1] = 0, n
    node = 0
    while node < nodes:
        start, stop = span[node, 0], span[node, 1]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in range(start, stop):
            for v in range(3):
                for k in range(3):
                    x = triangles[order[i], v, k]
                    low[k], high[k] = min(low[k], x), max(high[k], x)
        box[node, 0], box[node, 1] = low, high
        if stop - start > LEAF:
            axis = 0
            for k in range(1, 3):
                if high[k] - low[k] > high[axis] - low[axis]:
                    axis = k
            here = order[start:stop].copy()
            order[start:stop] = here[np.argsort(middle[here, axis], kind="mergesort")]
            child[node] = nodes
            half = (start + stop) // 2
            span[nodes, 0], span[nodes, 1] = start, half
            span[nodes + 1, 0], span[nodes + 1, 1] = half, stop
            nodes += 2
        node += 1
    return box[:nodes], child[:nodes], span[:nodes], order


@njit(cache=True)
def _box2(p, box):
    out = 0.0
    for k in range(3):
        d = max(box[0, k] - p[k], p[k] - box[1, k])
        if d > 0:
            out += d * d
    return out


@njit(cache=True)
def _reach2(points, box):
    out = 0.0
    for i in range(len(points)):
        out = max(out, _box2(points[i], box))
    return out


@njit(cache=True)
def cover2(points, triangles, box, child, span, order, enough):
    """Return (d2, triangle): min over the triangles of max over the points (k,3) of their squared distance.

    The distance from a convex set is a convex function: no point of the convex hull of `points` is farther from the
    triangle found than that, and none farther from the surface. Ends early with a triangle within `enough`.
    """
    best = np.inf
    found = -1
    stack = np.empty(2 * MOST_DEPTH, np.int64)
    stack[0] = 0
    top = 1
    while top > 0 and best > enough:
        top -= 1
        node = stack[top]
        if _reach2(points, box[node]) >= best:
            continue
        if child[node] < 0:
            for i in range(span[node, 0], span[node, 1]):
                far = 0.0
                for v in range(len(points)):
                    far = max(far, triangle2(points[v], triangles[order[i]]))
                    if far >= best:
                        break
                if far < best:
                    best, found = far, order[i]
            continue
        near, other = child[node], child[node] + 1
        if _reach2(points, box[near]) > _reach2(points, box[other]):
            near, other = other, near
        stack[top], stack[top + 1] = other, near
        top += 2
    return best, found


@njit(cache=True)
def farthest_vertex(surface, triangles, box, child, span, order):
    """Return the largest distance of any corner of surface (S,3,3) from the triangles: a lower bound of `farthest`."""
    out = 0.0
    one = np.empty((1, 3))
    for s in range(len(surface)):
        for v in range(3):
            one[0] = surface[s, v]
            out = max(out, cover2(one, triangles, box, child, span, order, out)[0])
    return np.sqrt(out)


@njit(cache=True)
def _side(p, t, e):
    """Return how far p stands outside the plane through edge e of triangle t that is perpendicular to t."""
    a, b, c = t[e], t[(e + 1) % 3], t[(e + 2) % 3]
    # In the triangle's plane, across the edge and away from c: (b - a) x ((b - a) x (c - a)).
    uu, uv, vv, up, vp = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, q = b[k] - a[k], c[k] - a[k], p[k] - a[k]
        uu += u * u
        uv += u * v
        vv += v * v
        up += u * q
        vp += v * q
    size = uu * (uu * vv - uv * uv)
    return (up * uv - vp * uu) / np.sqrt(size) if size > 0 else 0.0


@njit(cache=True)
def _push(polygon, n, level, stack, depth, top):
    for k in range(1, n - 1):
        stack[top, 0], stack[top, 1], stack[top, 2] = polygon[0], polygon[k], polygon[k + 1]
        depth[top] = level
        top += 1
    return top


@njit(cache=True)
def cut_along(t, by, thin, level, stack, depth, top, inside, outside):
    """Push the parts of triangle t over triangle `by` (perpendicular to it) and beside it; return the new top.

    Returns `top` as it was where nothing lies beside it by more than `thin`, or nothing over it. inside, outside (9,3)
    f64 are scratch.
    """
    n = 3
    inside[:3] = t
    first = top
    side = np.empty(9)
    for e in range(3):
        for k in range(n):
            side[k] = _side(inside[k], by, e)
            if abs(side[k]) <= thin:
                side[k] = 0.0
        beyond = False
        for k in range(n):
            if side[k] > 0:
                beyond = True
        if not beyond:
            continue
        within, without = 0, 0
        kept = np.empty((9, 3))
        for k in range(n):
            j = (k + 1) % n
            if side[k] <= 0:
                kept[within] = inside[k]
                within += 1
            if side[k] >= 0:
                outside[without] = inside[k]
                without += 1
            if (side[k] < 0 and side[j] > 0) or (side[k] > 0 and side[j] < 0):
                share = side[k] / (side[k] - side[j])
                for c in range(3):
                    x = inside[k, c] + share * (inside[j, c] - inside[k, c])
                    kept[within, c] = x
                    outside[without, c] = x
                within += 1
                without += 1
        if within < 3:
            return first
        top = _push(outside, without, level, stack, depth, top)
        n = within
        inside[:n] = kept[:n]
    return first if top == first else _push(inside, n, level, stack, depth, top)


@njit(cache=True)
def _quarter(t, level, stack, depth, top):
    ab, bc, ca = (t[0] + t[1]) / 2, (t[1] + t[2]) / 2, (t[2] + t[0]) / 2
    for q in range(4):
        depth[top + q] = level
    stack[top, 0], stack[top, 1], stack[top, 2] = t[0], ab, ca
    stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = ab, t[1], bc
    stack[top + 2, 0], stack[top + 2, 1], stack[top + 2, 2] = ca, bc, t[2]
    stack[top + 3, 0], stack[top + 3, 1], stack[top + 3, 2] = ab, bc, ca
    return top + 4


@njit(cache=True)
def farthest(surface, triangles, box, child, span, order, known, slack, most_pieces):
    """Return an upper bound of the distance of any point of surface (S,3,3) from the triangles, at least `known`.

    known, slack  what is below `known` need not be told apart; above it, the bound exceeds the true maximum by about a
                  factor of 1 + slack, unless that takes more than most_pieces pieces: then it is larger, never smaller
    """
    reached2 = known * known  # some point is that far
    bound2 = reached2  # none is farther
    loose = (1 + slack) * (1 + slack)
    thin = known / 1024  # slivers that thin are not cut off: they would never end
    stack, depth = np.empty((14 * MOST_CUTS, 3, 3)), np.empty(14 * MOST_CUTS, np.int64)
    inside, outside, one = np.empty((9, 3)), np.empty((9, 3)), np.empty((1, 3))
    pieces = 0
    for s in range(len(surface)):
        stack[0], depth[0] = surface[s], 0
        top = 1
        while top > 0:
            top -= 1
            t = stack[top].copy()
            level = depth[top]
            pieces += 1
            far, _ = cover2(t, triangles, box, child, span, order, bound2)
            if far <= bound2:
                continue
            for v in range(3):
                one[0] = t[v]
                reached2 = max(reached2, cover2(one, triangles, box, child, span, order, reached2)[0])
            bound2 = max(bound2, reached2)
            if far <= reached2 * loose or level == MOST_CUTS - 1 or pieces > most_pieces:
                bound2 = max(bound2, far)
                continue
            one[0] = (t[0] + t[1] + t[2]) / 3
            _, under = cover2(one, triangles, box, child, span, order, -1.0)
            before = top
            top = cut_along(t, triangles[under], thin, level + 1, stack, depth, top, inside, outside)
            if top == before:
                top = _quarter(t, level + 1, stack, depth, top)
    return np.sqrt(bound2)
