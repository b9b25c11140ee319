"""Kernels of mode `conservative`: targets, and the search for a place where every sight line is blocked.

`conservative.py` states what is proved and the bounds.
"""

import numpy as np
from numba import njit

from farfield.visibility.raster_kernels import heights, span, touches

BLOCK = 16  # squares a side of a block that is leapt over where it is too low
STRIDE = 0.25
WIDEST = 64  # squares; wider bundles of sight lines are not looked at


@njit(cache=True)
def target_parts(vertex, triangle, owner, x0, z0, size, pad, nx, nz, tile, box, fill):
    """Count, and with `fill` list, the parts of triangles over tiles: tile[n] (square index) and box[n] (2,3)."""
    half = 0.5 * size + pad
    n = 0
    for t in range(len(triangle)):
        a, b, c = vertex[triangle[t, 0]], vertex[triangle[t, 1]], vertex[triangle[t, 2]]
        low_x, high_x = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        low_z, high_z = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
        i0, i1 = span(low_x, high_x, x0, size, pad, nx)
        k0, k1 = span(low_z, high_z, z0, size, pad, nz)
        for i in range(i0, i1 + 1):
            for k in range(k0, k1 + 1):
                px, pz = x0 + (i + 0.5) * size, z0 + (k + 0.5) * size
                if not touches(a[0], a[2], b[0], b[2], c[0], c[2], px, pz, half):
                    continue
                if fill:
                    tile[n] = owner[t] * (nx * nz) + i * nz + k
                    low_y, high_y = heights(vertex, triangle, t, px, pz, half)
                    box[n, 0, 0], box[n, 1, 0] = max(low_x, px - half), min(high_x, px + half)
                    box[n, 0, 1], box[n, 1, 1] = low_y, high_y
                    box[n, 0, 2], box[n, 1, 2] = max(low_z, pz - half), min(high_z, pz + half)
                n += 1
    return n


@njit(cache=True)
def _reaches(table, i0, i1, k0, k1, y):
    """Is table[0] at least y over all squares [i0, i1] x [k0, k1]? Outside the raster it is not."""
    levels, nx, nz = table.shape
    if i0 < 0 or k0 < 0 or i1 >= nx or k1 >= nz:
        return False
    shorter = min(i1 - i0, k1 - k0) + 1
    level = 0
    while level + 1 < levels and (2 << level) <= shorter:
        level += 1
    step = 1 << level
    i = i0
    while True:
        k = k0
        while True:
            if table[level, i, k] < y:
                return False
            if k + step > k1:
                break
            k = min(k + step, k1 - step + 1)
        if i + step > i1:
            break
        i = min(i + step, i1 - step + 1)
    return True


@njit(cache=True)
def highest_blocks(top, under, out):
    """out (bx,bz) f32: the greatest of both rasters (nx,nz) in each block of squares."""
    nx, nz = top.shape
    for i in range(nx):
        for k in range(nz):
            out[i // BLOCK, k // BLOCK] = max(out[i // BLOCK, k // BLOCK], top[i, k], under[i, k])


@njit(cache=True)
def blocked(
    low, high, to_low, to_high, own, own_cap, absent, raster, slack, on_ground, top, bottom, under, blocks, hint
):  # fmt: skip
    """Is every segment from box [low, high] to box [to_low, to_high] blocked by columns?

    own, own_cap  (4,) rectangle (x, z, x, z) and highest cap of the open solids that the target touches
    absent        (m,5) rectangles of solids that must not count, for targets that reach below the fifth number
    raster        (x0, z0, size);  slack  metres that bound all rounding here
    hint          (1,) how far from the box the last success was: neighbours are hidden by the same
    """
    x0, z0, size = raster
    px, pz = 0.5 * (low[0] + high[0]), 0.5 * (low[2] + high[2])
    dx, dz = 0.5 * (to_low[0] + to_high[0]) - px, 0.5 * (to_low[2] + to_high[2]) - pz
    hx, hz = 0.5 * (high[0] - low[0]), 0.5 * (high[2] - low[2])
    gx, gz = 0.5 * (to_high[0] - to_low[0]), 0.5 * (to_high[2] - to_low[2])
    far = max(abs(dx), abs(dz))
    n = int(far / size) + 1
    nx, nz = top.shape[1], top.shape[2]
    j = -1 if hint[0] < far else 0
    while j < n:
        t = (j + 0.5) / n if j >= 0 else hint[0] / far
        cx, cz = px + t * dx, pz + t * dz
        i, k = int(np.floor((cx - x0) / size)), int(np.floor((cz - z0) / size))
        j += 1
        if i < 0 or k < 0 or i >= nx or k >= nz:
            continue
        y_high = (1.0 - t) * high[1] + t * to_high[1] + slack
        highest = blocks[i // BLOCK, k // BLOCK]
        if highest < y_high:
            # Leap to where the line leaves the block, unless it sinks below the block's top before.
            ex = x0 + ((i // BLOCK) + (1 if dx > 0.0 else 0)) * BLOCK * size
            ez = z0 + ((k // BLOCK) + (1 if dz > 0.0 else 0)) * BLOCK * size
            tx = (ex - px) / dx if dx != 0.0 else np.inf
            tz = (ez - pz) / dz if dz != 0.0 else np.inf
            leave = min(tx, tz, 1.0)
            if j > 0 and highest < (1.0 - leave) * high[1] + leave * to_high[1]:
                j = max(j, int(leave * n))
            continue
        if max(top[0, i, k], under[0, i, k]) < y_high:
            continue
        rx, rz = (1.0 - t) * hx + t * gx + slack, (1.0 - t) * hz + t * gz + slack
        i0, i1 = int(np.floor((cx - rx - x0) / size)), int(np.floor((cx + rx - x0) / size))
        k0, k1 = int(np.floor((cz - rz - z0) / size)), int(np.floor((cz + rz - z0) / size))
        if max(i1 - i0, k1 - k0) >= WIDEST:
            continue
        if j > 0:
            j += int(STRIDE * min(rx, rz) / size)
        if not (on_ground and _reaches(under, i0, i1, k0, k1, y_high)):
            y_low = (1.0 - t) * low[1] + t * to_low[1] - slack
            if not (_reaches(top, i0, i1, k0, k1, y_high) and _reaches(bottom, i0, i1, k0, k1, -y_low)):
                continue
        if low[1] <= own_cap and cx + rx >= own[0] and cx - rx <= own[2] and cz + rz >= own[1] and cz - rz <= own[3]:
            continue
        clear = True
        for m in range(len(absent)):
            a = absent[m]
            if to_low[1] <= a[4] and cx + rx >= a[0] and cx - rx <= a[2] and cz + rz >= a[1] and cz - rz <= a[3]:
                clear = False
                break
        if clear:
            hint[0] = t * far
            return True
    return False


@njit(cache=True)
def hide(
    low, high, item, item_box, item_object, own, own_cap, absent, raster, slack, on_ground, top, bottom, under, blocks,
    kept, last, open_,
):  # fmt: skip
    """Set open_[j] where item[j] (ids in Morton order) is not proved hidden from box [low, high]; return the tests made.

    own, own_cap  (N,4), (N,) by object: see `blocked`
    kept          (N,) b1  objects that are kept already: not looked at, not reported
    last          an open item's object is kept from here on: the box is not divided further
    """
    n = len(item)
    m = 1
    while m < n:
        m *= 2
    box = np.empty((2 * m, 2, 3))
    rect = np.empty((2 * m, 4))
    cap = np.empty(2 * m)
    for j in range(m):
        node = m + j
        if j < n and not kept[item_object[item[j]]]:
            o = item_object[item[j]]
            box[node], rect[node], cap[node] = item_box[item[j]], own[o], own_cap[o]
        else:
            for axis in range(3):
                box[node, 0, axis], box[node, 1, axis] = np.inf, -np.inf
            rect[node, 0], rect[node, 1], rect[node, 2], rect[node, 3] = np.inf, np.inf, -np.inf, -np.inf
            cap[node] = -np.inf
    for node in range(m - 1, 0, -1):
        a, b = 2 * node, 2 * node + 1
        for axis in range(3):
            box[node, 0, axis] = min(box[a, 0, axis], box[b, 0, axis])
            box[node, 1, axis] = max(box[a, 1, axis], box[b, 1, axis])
        for axis in range(2):
            rect[node, axis] = min(rect[a, axis], rect[b, axis])
            rect[node, 2 + axis] = max(rect[a, 2 + axis], rect[b, 2 + axis])
        cap[node] = max(cap[a], cap[b])
    hint = np.full(1, np.inf)
    stack = np.empty(128, np.int64)
    stack[0], depth, tests = 1, 1, 0
    open_[:] = False
    while depth:
        depth -= 1
        node = stack[depth]
        if box[node, 0, 0] > box[node, 1, 0]:
            continue
        if node >= m and kept[item_object[item[node - m]]]:
            continue
        tests += 1
        if blocked(
            low, high, box[node, 0], box[node, 1], rect[node], cap[node], absent, raster, slack, on_ground, top, bottom,
            under, blocks, hint,
        ):  # fmt: skip
            continue
        if node >= m:
            open_[node - m] = True
            if last:
                kept[item_object[item[node - m]]] = True
        else:
            # Four at a time: of a node that fails, its two halves mostly fail as well.
            first, n_parts = (4 * node, 4) if 2 * node < m else (2 * node, 2)
            for part in range(n_parts - 1, -1, -1):
                stack[depth] = first + part
                depth += 1
    return tests
