"""Kernels of columns: which squares are opaque, between which heights.

`columns.py` states the problem and the bounds. Lengths are metres. A square is (i, k); its index is i * nz + k.
"""

import numpy as np
from numba import njit

from farfield.visibility.raster_kernels import heights
from farfield.visibility.solid_kernels import orient2d

MOST_LINES, MOST_FACES, MOST_CORNERS = 16, 40, 24


@njit(cache=True)
def _in_line(ax, az, bx, bz, cx, cz, dx, dz):
    return orient2d(ax, az, bx, bz, cx, cz) == 0 and orient2d(ax, az, bx, bz, dx, dz) == 0


@njit(cache=True)
def _ends(vertex, triangle, t):
    """The two corners of a vertical triangle that lie farthest apart seen from above (x, z, x, z)."""
    best, i0, i1 = -1.0, 0, 1
    for i in range(3):
        j = (i + 1) % 3
        p, q = vertex[triangle[t, i]], vertex[triangle[t, j]]
        d = (q[0] - p[0]) ** 2 + (q[2] - p[2]) ** 2
        if d > best:
            best, i0, i1 = d, i, j
    p, q = vertex[triangle[t, i0]], vertex[triangle[t, i1]]
    return p[0], p[2], q[0], q[2]


@njit(cache=True)
def _meets(line, i, j, k):
    """Do lines i, j and k meet in one point exactly? Known only where that is an end of a wall."""
    for m in (i, j, k):
        for end in range(2):
            x, z = line[m, 2 * end], line[m, 2 * end + 1]
            hit = 0
            for n in (i, j, k):
                if orient2d(line[n, 0], line[n, 1], line[n, 2], line[n, 3], x, z) == 0:
                    hit += 1
            if hit == 3:
                return True
    return False


@njit(cache=True)
def _faces(line, n_lines, px, pz, half, size, corner, edge, count, centre):
    """Cut the square about p by lines (n,4) f64; return how many faces there are, -1 if one cannot be resolved.

    corner  (F,C,2) f64  corners of each face relative to p       edge  (F,C) i64  line of the edge that starts there,
    count   (F,) i64                                                               -1 to -4: sides of the square
    centre  (F,2) f64    a point strictly inside each face, clear of all lines
    """
    for c in range(4):
        corner[0, c, 0] = -half if c == 0 or c == 3 else half
        corner[0, c, 1] = -half if c < 2 else half
        edge[0, c] = -1 - c
    count[0] = 4
    n = 1
    distance = np.empty(MOST_CORNERS)
    for cut in range(n_lines):
        ax, az = line[cut, 0] - px, line[cut, 1] - pz
        dx, dz = line[cut, 2] - line[cut, 0], line[cut, 3] - line[cut, 1]
        length = np.sqrt(dx * dx + dz * dz)
        ox, oz = -dz / length, dx / length
        # Distances of corners round by less than 2**-49 of this; what a line may cut off unseen at a corner on a side
        # of the padded square is at most on / off of an edge long, less than the pad.
        far = abs(ax) + abs(az) + abs(dx) + abs(dz) + size
        on, off = far * 2.0**-44, size * 2.0**-22
        if on > off * 2.0**-12:
            return -1
        for f in range(n):
            below, above, ons, first_on, last_on = 0, 0, 0, -1, -1
            for c in range(count[f]):
                d = ox * (corner[f, c, 0] - ax) + oz * (corner[f, c, 1] - az)
                distance[c] = d
                if abs(d) <= on:
                    ons += 1
                    if first_on < 0:
                        first_on = c
                    last_on = c
                elif abs(d) < off:
                    return -1
                elif d > 0.0:
                    above += 1
                else:
                    below += 1
            if ons > 2:
                return -1
            for c in range(count[f]):
                if abs(distance[c]) <= on:
                    before, after = edge[f, (c + count[f] - 1) % count[f]], edge[f, c]
                    # Beside a side of the padded square what is lost lies outside the square itself.
                    if before >= 0 and after >= 0 and not _meets(line, cut, before, after):
                        return -1
            if ons == 2 and (below == 0 or above == 0):
                # The line runs along an edge: only along a side of the padded square nothing inside is lost.
                shared = edge[f, first_on] if last_on == first_on + 1 else edge[f, last_on]
                adjacent = last_on == first_on + 1 or (first_on == 0 and last_on == count[f] - 1)
                if not adjacent or shared >= 0:
                    return -1
            if below == 0 or above == 0:
                continue
            if n == MOST_FACES or count[f] + 2 > MOST_CORNERS:
                return -1
            m, last = 0, 0
            old, old_edge, total = corner[f].copy(), edge[f].copy(), count[f]
            for c in range(total):
                e = (c + 1) % total
                s0 = 0 if abs(distance[c]) <= on else (1 if distance[c] > 0.0 else -1)
                s1 = 0 if abs(distance[e]) <= on else (1 if distance[e] > 0.0 else -1)
                if s0 >= 0:
                    corner[f, m] = old[c]
                    edge[f, m] = cut if s0 == 0 and s1 < 0 else old_edge[c]
                    m += 1
                if s0 <= 0:
                    corner[n, last] = old[c]
                    edge[n, last] = cut if s0 == 0 and s1 > 0 else old_edge[c]
                    last += 1
                if s0 * s1 < 0:
                    w = distance[c] / (distance[c] - distance[e])
                    x = old[c, 0] + (old[e, 0] - old[c, 0]) * w
                    z = old[c, 1] + (old[e, 1] - old[c, 1]) * w
                    corner[f, m, 0], corner[f, m, 1] = x, z
                    edge[f, m] = cut if s0 > 0 else old_edge[c]
                    m += 1
                    corner[n, last, 0], corner[n, last, 1] = x, z
                    edge[n, last] = cut if s0 < 0 else old_edge[c]
                    last += 1
            count[f], count[n] = m, last
            n += 1
    for f in range(n):
        x, z = 0.0, 0.0
        for c in range(count[f]):
            x += corner[f, c, 0]
            z += corner[f, c, 1]
        x, z = px + x / count[f], pz + z / count[f]
        centre[f, 0], centre[f, 1] = x, z
        for cut in range(n_lines):
            dx, dz = line[cut, 2] - line[cut, 0], line[cut, 3] - line[cut, 1]
            length = np.sqrt(dx * dx + dz * dz)
            far = abs(line[cut, 0]) + abs(line[cut, 1]) + abs(dx) + abs(dz) + abs(x) + abs(z) + size
            if abs(dx * (z - line[cut, 1]) - dz * (x - line[cut, 0])) <= length * far * 2.0**-43:
                return -1
    return n


@njit(cache=True)
def _over(vertex, triangle, t, x, z):
    """Does triangle t lie over the point moved by (e**2, e), for every small e > 0?"""
    inside = False
    for k in range(3):
        p, q = vertex[triangle[t, k]], vertex[triangle[t, (k + 1) % 3]]
        if (p[2] <= z) != (q[2] <= z):
            turn = orient2d(p[0], p[2], q[0], q[2], x, z)
            if (turn > 0) == (q[2] > p[2]) and turn != 0:
                inside = not inside
    return inside


@njit(cache=True)
def _inside(vertex, triangle, up, entry, first, last, x, z, low, high, y_low, y_high, cap, culled):
    """Is (x, z) between heights low and high inside the solid that entries [first, last) of the square belong to?

    No triangle of it crosses the prism, so those on the side away from its cap decide.
    """
    downwards = not np.isnan(cap) and high <= cap
    winding, odd = 0, False
    for e in range(first, last):
        t = entry[e]
        if up[t] == 0:
            continue
        beyond = (y_high[e - first] <= low) if downwards else (y_low[e - first] >= high)
        if beyond and _over(vertex, triangle, t, x, z):
            odd = not odd
            winding += up[t]
    return winding > 0 if culled else odd


@njit(cache=True)
def _opaque_gap(
    vertex, triangle, up, solid, entry, first, last, y_low, y_high, cap_y, culled, px, pz, half, size, scratch
):
    """The tallest prism over the square in which each point is inside one of the solids of entries [first, last).

    Returns (bottom, top), (inf, -inf) if there is none. Prisms reach from one sloped or level triangle, or cap, to the
    next; only vertical triangles enter them, and these cut the square into faces on which nothing changes.
    """
    line, corner, edge, count, centre, base = scratch
    low = np.empty(2 * (last - first))
    high = np.empty(2 * (last - first))
    n, previous = 0, -1
    for e in range(first, last):
        s = solid[entry[e]]
        if s != previous and not np.isnan(cap_y[s]):
            low[n], high[n] = cap_y[s], cap_y[s]
            n += 1
        previous = s
        if up[entry[e]] != 0:
            low[n], high[n] = y_low[e - base[0]], y_high[e - base[0]]
            n += 1
    order = np.argsort(low[:n])
    gap_low, gap_high = np.empty(n), np.empty(n)
    gaps, reached = 0, -np.inf
    for o in order:
        if low[o] > reached and reached > -np.inf:
            gap_low[gaps], gap_high[gaps] = reached, low[o]
            gaps += 1
        reached = max(reached, high[o])
    for g in np.argsort(gap_low[:gaps] - gap_high[:gaps]):
        bottom, top = gap_low[g], gap_high[g]
        lines, ok = 0, True
        for e in range(first, last):
            t = entry[e]
            if up[t] != 0 or y_high[e - base[0]] <= bottom or y_low[e - base[0]] >= top:
                continue
            ax, az, bx, bz = _ends(vertex, triangle, t)
            known = False
            for old in range(lines):
                if _in_line(line[old, 0], line[old, 1], line[old, 2], line[old, 3], ax, az, bx, bz):
                    known = True
                    break
            if known:
                continue
            if lines == MOST_LINES:
                ok = False
                break
            line[lines, 0], line[lines, 1], line[lines, 2], line[lines, 3] = ax, az, bx, bz
            lines += 1
        if not ok:
            continue
        n_faces = _faces(line, lines, px, pz, half, size, corner, edge, count, centre)
        ok = n_faces > 0
        for f in range(max(n_faces, 0)):
            covered, start = False, first
            while start < last and not covered:
                s = solid[entry[start]]
                stop = start
                while stop < last and solid[entry[stop]] == s:
                    stop += 1
                covered = _inside(
                    vertex, triangle, up, entry, start, stop, centre[f, 0], centre[f, 1], bottom, top,
                    y_low[start - base[0] :], y_high[start - base[0] :], cap_y[s], culled[s],
                )  # fmt: skip
                start = stop
            if not covered:
                ok = False
                break
        if ok:
            return bottom, top
    return np.inf, -np.inf


@njit(cache=True)
def opaque_squares(
    vertex, triangle, up, solid, cap_y, culled, row, entry, ground_low, x0, z0, size, pad, nx, nz, bottom, top
):
    """Set bottom, top (nx*nz,) f64 of the opaque prism over each square, inf and -inf where there is none.

    One solid at a time first: what stands in a house does not open it. All together where none does alone, for party
    walls. Of several, one whose bottom is under the ground, then the tallest.
    """
    half = 0.5 * size + pad
    base = np.zeros(1, np.int64)
    scratch = (
        np.empty((MOST_LINES, 4)), np.empty((MOST_FACES + 1, MOST_CORNERS, 2)),
        np.empty((MOST_FACES + 1, MOST_CORNERS), np.int64), np.empty(MOST_FACES + 1, np.int64),
        np.empty((MOST_FACES + 1, 2)), base,
    )  # fmt: skip
    for s in range(nx * nz):
        bottom[s], top[s] = np.inf, -np.inf
        first, last = row[s], row[s + 1]
        if first == last:
            continue
        px, pz = x0 + (s // nz + 0.5) * size, z0 + (s % nz + 0.5) * size
        base[0] = first
        y_low, y_high = np.empty(last - first), np.empty(last - first)
        for e in range(first, last):
            y_low[e - first], y_high[e - first] = heights(vertex, triangle, entry[e], px, pz, half)
        start, solids, best = first, 0, -np.inf
        while start < last:
            stop = start
            while stop < last and solid[entry[stop]] == solid[entry[start]]:
                stop += 1
            a, b = _opaque_gap(
                vertex,
                triangle,
                up,
                solid,
                entry,
                start,
                stop,
                y_low,
                y_high,
                cap_y,
                culled,
                px,
                pz,
                half,
                size,
                scratch,
            )
            rank = -np.inf if a > b else (b + 1e30 if a <= ground_low[s] else b - a)
            if rank > best:
                bottom[s], top[s], best = a, b, rank
            start, solids = stop, solids + 1
        if best == -np.inf and solids > 1:
            bottom[s], top[s] = _opaque_gap(
                vertex,
                triangle,
                up,
                solid,
                entry,
                first,
                last,
                y_low,
                y_high,
                cap_y,
                culled,
                px,
                pz,
                half,
                size,
                scratch,
            )
