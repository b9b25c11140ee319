"""Kernels of stage hierarchy; `build.py` documents and checks."""

import numpy as np
from numba import njit


@njit(cache=True)
def find_split(high, low, start, stop):
    """Return where the radix tree cuts the sorted range: before the first key with the highest differing bit set.

    Keys that are all equal are cut in the middle.
    """
    word = high if high[start] != high[stop - 1] else low
    differing = word[start] ^ word[stop - 1]
    if differing == 0:
        return (start + stop + 1) // 2
    bit = np.uint64(1)
    while differing > np.uint64(1):
        differing >>= np.uint64(1)
        bit <<= np.uint64(1)
    a, b = start, stop - 1  # the bit is clear at a, set at b, and everything above it is equal
    while b - a > 1:
        middle = (a + b) // 2
        if word[middle] & bit:
            b = middle
        else:
            a = middle
    return b


@njit(cache=True)
def radix_tree(high, low, start, stop, left, right, parent):
    """Fill the preorder columns of the binary radix tree over sorted keys (high, low), leaves of one key."""
    n = len(high)
    waiting = np.empty((256, 3), dtype=np.int64)  # at most 126 + log2(n) levels: range, and the node it hangs from
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, n, -1
    n_waiting, node = 1, 0
    while n_waiting:
        n_waiting -= 1
        a, b, above = waiting[n_waiting, 0], waiting[n_waiting, 1], waiting[n_waiting, 2]
        start[node], stop[node], parent[node] = a, b, above
        left[node] = right[node] = -1
        if above >= 0:
            if a == start[above]:
                left[above] = node
            else:
                right[above] = node
        if b - a > 1:
            cut = find_split(high, low, a, b)
            waiting[n_waiting, 0], waiting[n_waiting, 1], waiting[n_waiting, 2] = cut, b, node
            waiting[n_waiting + 1, 0], waiting[n_waiting + 1, 1], waiting[n_waiting + 1, 2] = a, cut, node
            n_waiting += 2
        node += 1


@njit(cache=True)
def gather(parent, box, calls, triangles, size_bytes, replaceable):
    """Sum and join each node into its parent, children first."""
    for node in range(len(parent) - 1, 0, -1):
        p = parent[node]
        for axis in range(3):
            box[p, 0, axis] = min(box[p, 0, axis], box[node, 0, axis])
            box[p, 1, axis] = max(box[p, 1, axis], box[node, 1, axis])
        calls[p] += calls[node]
        triangles[p] += triangles[node]
        size_bytes[p] += size_bytes[node]
        replaceable[p] &= replaceable[node]
