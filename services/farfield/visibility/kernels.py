"""Numba kernels of from-region visibility: placing triangles, walking lines through the cells, sets as bits.

A set of objects is a row of 64-bit words: object o is bit o % 64 of word o // 64.
"""

import math

import numpy as np
from numba import njit

_ONE = np.uint64(1)


@njit(cache=True)
def place_triangles(position, index, first, row, matrix, corner, area):
    """Fill corner (T,3,3) f32 and area (T,) f64: triangles [first[o], ...) of each object's mesh, at row[o]."""
    p = np.empty((3, 3))
    for o in range(len(first)):
        m = matrix[o]
        mirrored = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        ) < 0
        for k in range(row[o + 1] - row[o]):
            t = row[o] + k
            for c in range(3):
                v = position[index[first[o] + k, 2 - c if mirrored else c]]
                for a in range(3):
                    p[c, a] = m[a, 0] * v[0] + m[a, 1] * v[1] + m[a, 2] * v[2] + m[a, 3]
                    corner[t, c, a] = p[c, a]
            ux, uy, uz = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
            vx, vy, vz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area[t] = math.sqrt(x * x + y * y + z * z) / 2


@njit(cache=True)
def crosses(box, o, inverse, t0, t1):
    """Return whether the points o + t d with t in [t0, t1] meet the closed box (2,3); inverse (3,) is 1 / d."""
    for k in range(3):
        if math.isinf(inverse[k]):
            if o[k] < box[0, k] or o[k] > box[1, k]:
                return False
            continue
        a = (box[0, k] - o[k]) * inverse[k]
        b = (box[1, k] - o[k]) * inverse[k]
        if a > b:
            a, b = b, a
        t0 = max(t0, a)
        t1 = min(t1, b)
        if t0 > t1:
            return False
    return True


@njit(cache=True)
def mark_lines(
    tree_low, tree_high, tree_box, tree_start, origin, direction, back, ahead, behind, front, seen, own, news
):
    """Set both end objects of each line in every cell that its free segment crosses.

    back, ahead    (R,) f64  the segment is o + t d, -back <= t <= ahead (inf: open)
    behind, front  (R,) i32  objects at its ends, -1: none
    seen           (L,W) u64  in and out
    own            (2,) the cells whose new pairs are wanted, half-open
    news           (R,2) i32  out: such a cell where `behind` (0) or `front` (1) was not yet set, else -1
    """
    inverse = np.empty(3)
    stack = np.empty(256, dtype=np.int32)
    for r in range(len(origin)):
        news[r, 0] = news[r, 1] = -1
        if behind[r] < 0 and front[r] < 0:
            continue
        for k in range(3):
            inverse[k] = 1 / direction[r, k] if direction[r, k] != 0 else np.inf
        stack[0] = 0
        size = 1
        while size:
            size -= 1
            node = stack[size]
            if not crosses(tree_box[node], origin[r], inverse, -back[r], ahead[r]):
                continue
            if tree_low[node] >= 0:
                stack[size], stack[size + 1] = tree_high[node], tree_low[node]
                size += 2
                continue
            cell = tree_start[node]
            for side in range(2):
                o = behind[r] if side == 0 else front[r]
                if o < 0:
                    continue
                bit = _ONE << np.uint64(o & 63)
                if not seen[cell, o >> 6] & bit:
                    seen[cell, o >> 6] |= bit
                    if own[0] <= cell < own[1]:
                        news[r, side] = cell


@njit(cache=True)
def is_seen(seen, cell, object, out):
    """Fill out (K,) b1: whether each pair is set. Objects of -1 count as seen."""
    for k in range(len(cell)):
        o = object[k]
        out[k] = o < 0 or (seen[cell[k], o >> 6] >> np.uint64(o & 63)) & _ONE != 0


@njit(cache=True)
def bits_of(word):
    """Return how many bits of a 64-bit word are set."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True)
def frontier(seen, cells, row, neighbour, out):
    """Fill out (C,W) u64: what a neighbour of cells[c] sees and it does not; return the number of pairs (C,) i64."""
    count = np.zeros(len(cells), dtype=np.int64)
    for c in range(len(cells)):
        for w in range(seen.shape[1]):
            word = np.uint64(0)
            for k in range(row[c], row[c + 1]):
                word |= seen[neighbour[k], w]
            word &= ~seen[cells[c], w]
            out[c, w] = word
            count[c] += bits_of(word)
    return count


@njit(cache=True)
def pick(sets, ranks, row, object):
    """Fill row (K,) i32 and object (K,) i32: the members of `sets` (C,W) u64 at the ascending `ranks` (K,) i64."""
    before = 0
    k = 0
    for c in range(len(sets)):
        for w in range(sets.shape[1]):
            word = sets[c, w]
            inside = bits_of(word)
            while k < len(ranks) and ranks[k] < before + inside:
                left = ranks[k] - before
                bit = 0
                rest = word
                while True:
                    if rest & _ONE:
                        if left == 0:
                            break
                        left -= 1
                    rest >>= _ONE
                    bit += 1
                row[k], object[k] = c, 64 * w + bit
                k += 1
            before += inside


@njit(cache=True)
def members(sets, row, object):
    """Fill object (E,) i32 with the members of each set (C,W) u64, ascending; row (C+1,) i64 says where they begin."""
    for c in range(len(sets)):
        at = row[c]
        for w in range(sets.shape[1]):
            word = sets[c, w]
            o = 64 * w
            while word:
                if word & _ONE:
                    object[at] = o
                    at += 1
                word >>= _ONE
                o += 1


@njit(cache=True)
def sizes(sets):
    """Return (C,) i64: how many members each set (C,W) u64 has."""
    out = np.zeros(len(sets), dtype=np.int64)
    for c in range(len(sets)):
        for w in range(sets.shape[1]):
            out[c] += bits_of(sets[c, w])
    return out
