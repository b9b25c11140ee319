"""Kernels of rasters: which squares a triangle touches, how high it stands there, and least values over windows.

`columns.py` states the problem and the bounds. Lengths are metres. A square is (i, k); its index is i * nz + k.
"""

import numpy as np
from numba import njit

_U = 2.0**-53


@njit(cache=True)
def span(low, high, x0, size, pad, n):
    first = int(np.floor((low - pad - x0) / size)) - 1
    last = int(np.floor((high + pad - x0) / size)) + 1
    return max(first, 0), min(last, n - 1)


@njit(cache=True)
def touches(ax, az, bx, bz, cx, cz, px, pz, half):
    """May the triangle touch the square of half size `half` (pad included) about p? Never wrongly no: the pad is
    2**-10 of a square, the products round by 2**-50 of themselves."""
    if min(ax, bx, cx) > px + half or max(ax, bx, cx) < px - half:
        return False
    if min(az, bz, cz) > pz + half or max(az, bz, cz) < pz - half:
        return False
    area = (bx - ax) * (cz - az) - (bz - az) * (cx - ax)
    for k in range(3):
        if k == 0:
            ux, uz, vx, vz = ax, az, bx, bz
        elif k == 1:
            ux, uz, vx, vz = bx, bz, cx, cz
        else:
            ux, uz, vx, vz = cx, cz, ax, az
        dx, dz = vx - ux, vz - uz
        e = dx * (pz - uz) - dz * (px - ux)
        reach = half * (abs(dx) + abs(dz))
        # A sliver's area may have the wrong sign: it is then thinner than the pad, and both signs must be far away.
        thin = abs(area) <= reach * 2.0**-20
        if (thin and abs(e) > 2.0 * reach) or (not thin and (e < -reach if area > 0.0 else e > reach)):
            return False
    return True


@njit(cache=True)
def touched(vertex, triangle, members, x0, z0, size, pad, nx, nz, row, entry, fill):
    """Count (fill False: row[square + 1] += 1) or list (row[square] advances) the triangles `members` over each square."""
    half = 0.5 * size + pad
    for m in range(len(members)):
        t = members[m]
        a, b, c = vertex[triangle[t, 0]], vertex[triangle[t, 1]], vertex[triangle[t, 2]]
        i0, i1 = span(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), x0, size, pad, nx)
        k0, k1 = span(min(a[2], b[2], c[2]), max(a[2], b[2], c[2]), z0, size, pad, nz)
        for i in range(i0, i1 + 1):
            for k in range(k0, k1 + 1):
                px, pz = x0 + (i + 0.5) * size, z0 + (k + 0.5) * size
                if touches(a[0], a[2], b[0], b[2], c[0], c[2], px, pz, half):
                    s = i * nz + k
                    if fill:
                        entry[row[s]] = t
                        row[s] += 1
                    else:
                        row[s + 1] += 1


@njit(cache=True)
def heights(vertex, triangle, t, px, pz, half):
    """Bounds (low, high) of the height of triangle t over the square about p: its plane's with the bound of its
    rounding, no further out than its corners. Vertical triangles: their corners'."""
    a, b, c = vertex[triangle[t, 0]], vertex[triangle[t, 1]], vertex[triangle[t, 2]]
    low, high = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    # Each component: differences and products round once, their difference once: 4 u of the products' sizes.
    ex = 4.0 * _U * (abs(uy * vz) + abs(uz * vy))
    ey = 4.0 * _U * (abs(uz * vx) + abs(ux * vz))
    ez = 4.0 * _U * (abs(ux * vy) + abs(uy * vx))
    if abs(ny) <= 2.0 * ey or ny == 0.0:
        return low, high
    gx, gz = -nx / ny, -nz / ny
    egx, egz = 2.0 * (ex + abs(gx) * ey) / abs(ny), 2.0 * (ez + abs(gz) * ey) / abs(ny)
    dx, dz = px - a[0], pz - a[2]
    y = a[1] + gx * dx + gz * dz
    reach = abs(gx) * half + abs(gz) * half
    error = (egx * (abs(dx) + half) + egz * (abs(dz) + half)) + 8.0 * _U * (
        abs(a[1]) + abs(gx) * (abs(dx) + abs(px) + half) + abs(gz) * (abs(dz) + abs(pz) + half)
    )
    return max(low, y - reach - error), min(high, y + reach + error)


@njit(cache=True)
def ground_heights(vertex, triangle, members, x0, z0, size, pad, nx, nz, low, high):
    """Lower low[square] and raise high[square] to bounds of the ground over it."""
    half = 0.5 * size + pad
    for m in range(len(members)):
        t = members[m]
        a, b, c = vertex[triangle[t, 0]], vertex[triangle[t, 1]], vertex[triangle[t, 2]]
        i0, i1 = span(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), x0, size, pad, nx)
        k0, k1 = span(min(a[2], b[2], c[2]), max(a[2], b[2], c[2]), z0, size, pad, nz)
        for i in range(i0, i1 + 1):
            for k in range(k0, k1 + 1):
                px, pz = x0 + (i + 0.5) * size, z0 + (k + 0.5) * size
                if touches(a[0], a[2], b[0], b[2], c[0], c[2], px, pz, half):
                    y0, y1 = heights(vertex, triangle, t, px, pz, half)
                    s = i * nz + k
                    low[s], high[s] = min(low[s], y0), max(high[s], y1)


@njit(cache=True)
def in_domain(domain, x0, z0, size, nx, nz, out):
    """Mark the squares that lie in every half plane a x + b z <= c (h,3), with 2**-40 of c to spare."""
    for i in range(nx):
        for k in range(nz):
            px, pz = x0 + (i + 0.5) * size, z0 + (k + 0.5) * size
            inside = len(domain) > 0
            for h in range(len(domain)):
                a, b, c = domain[h]
                reach = 0.5 * size * (abs(a) + abs(b))
                if a * px + b * pz + reach > c - 2.0**-40 * (abs(c) + abs(px) + abs(pz) + size):
                    inside = False
                    break
            out[i * nz + k] = inside


@njit(cache=True)
def bury(row, entry, solid, cap_y, ground_low, buried):
    """Clear buried[s] of solids whose cap is not under the ground over some square that they touch."""
    for square in range(len(row) - 1):
        for e in range(row[square], row[square + 1]):
            s = solid[entry[e]]
            if not cap_y[s] <= ground_low[square]:
                buried[s] = False


@njit(cache=True)
def minimum_windows(table):
    """Fill table[l] (L,nx,nz) f32 from table[0]: the least value in the window of 2**l squares that starts at (i, k).

    Windows that leave the raster hold -inf.
    """
    levels, nx, nz = table.shape
    for level in range(1, levels):
        step = 1 << (level - 1)
        for i in range(nx):
            for k in range(nz):
                if i + 2 * step > nx or k + 2 * step > nz:
                    table[level, i, k] = -np.inf
                else:
                    a = min(table[level - 1, i, k], table[level - 1, i + step, k])
                    b = min(table[level - 1, i, k + step], table[level - 1, i + step, k + step])
                    table[level, i, k] = min(a, b)
