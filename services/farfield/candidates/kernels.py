"""Numba kernels of candidate generation. Cells are leaf cells of the view space, rows of `cell_box`."""

import math

import numpy as np
from numba import njit

from farfield.impostor.cells import shaft_holds, wrap_box, wrap_shaft
from farfield.impostor.frames import BOX, SHAFT, TEXEL, TEXELS, S, lay_out_best, weigh_quickly
from farfield.impostor.kernels import cut_triangles
from farfield.impostor.weight import IMPOSTOR_BYTES, LAYER_BYTES, MAX_LAYER_TRIANGLES, MAX_LAYERS, TEXEL_BYTES
from farfield.rendertime.kernels import impostor_cost, rect_pixels

DISTANCES = 11  # smallest distances of raw shafts: 2^0 .. 2^10 cluster sizes
ANGLES_DEG = (11.25, 22.5, 45.0, 90.0)  # apex angles of raw shafts
_HALF_SIN = np.sin(np.radians(np.array(ANGLES_DEG) / 2))
_HALF_COS = np.cos(np.radians(np.array(ANGLES_DEG) / 2))
ROOM = 2  # times the layers an impostor may have, that a single cell may seem to need in the quick view
_SEED = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True)
def mix(x):
    """Return a 64-bit hash of a 64-bit integer (splitmix64)."""
    x = np.uint64(x) + _SEED
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(cache=True)
def cell_keys(n):
    """Return (n,2) u64: 128 random bits a cell; the sum over a set, modulo 2^64 each, names the set."""
    out = np.empty((n, 2), dtype=np.uint64)
    for i in range(n):
        out[i, 0] = mix(np.uint64(2 * i))
        out[i, 1] = mix(np.uint64(2 * i + 1))
    return out


@njit(cache=True)
def shaft_class(apex, size, box, direction):
    """Return (angle, distance): the narrowest raw shaft along `direction` and the farthest that hold the box; -1, -1 if none.

    A raw shaft holds a box if it holds its bounding sphere: raw shafts only group cells, `farfield.impostor.cells` fits
    the real ones. It starts size * 2^distance from the apex along its axis.
    """
    along, reach2, lateral2, support = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        half = (box[1, k] - box[0, k]) / 2
        p = (box[0, k] + box[1, k]) / 2 - apex[k]
        along += p * direction[k]
        reach2 += half * half
        lateral2 += p * p
        support += abs(direction[k]) * half
    near = along - support
    if not near >= size:
        return -1, -1
    lateral = math.sqrt(max(0.0, lateral2 - along * along))
    reach = math.sqrt(reach2)
    for a in range(4):
        if along * _HALF_SIN[a] - lateral * _HALF_COS[a] >= reach:
            distance = 0
            while distance + 1 < DISTANCES and near >= size * 2.0 ** (distance + 1):
                distance += 1
            return a, distance
    return -1, -1


@njit(cache=True)
def _insert(table_key, table_id, slot_of, lo, hi, new_id):
    """Return the id stored under the 128-bit key, or store new_id and return -1. Open addressing; id -1 is free.

    slot_of  out: where new_id went, so that a table is emptied in as many steps as it holds sets
    """
    mask = np.uint64(len(table_id) - 1)
    slot = lo & mask
    while table_id[slot] >= 0:
        if table_key[slot, 0] == lo and table_key[slot, 1] == hi:
            return table_id[slot]
        slot = (slot + np.uint64(1)) & mask
    table_key[slot, 0], table_key[slot, 1], table_id[slot] = lo, hi, new_id
    slot_of[new_id] = slot
    return -1


@njit(cache=True)
def find_sets(
    apex, size, useful, cell_box, keys, directions, tree_start, tree_low, tree_high, shafts, boxes,
    bucket, bucket_count, hold, table_key, table_id, slot_of, source,
):  # fmt: skip
    """Find the distinct sets of useful cells that raw view cells hold; return how many, and fill `source` (S,4).

    useful       (U,) ascending cells that count; cell_box (U,2,3) and keys (U,2) are theirs
    tree_start, tree_low, tree_high  (K,) first leaf and children of the view-space tree's nodes: raw boxes, where `boxes`
    bucket       (D,4,11,2) u64 zeros, bucket_count (D,4,11) i32 zeros: scratch, left zero
    hold         (D,U) u1 out: 11 a + k of the narrowest and farthest raw shaft that holds a useful cell; 255 none
    table_key, table_id    hash table, ids -1, length a power of two; left so. slot_of (S,) scratch
    source       rows: direction, angle, distance of a raw shaft that holds the set, cells in it; a node of the tree is
                 -1, node, 0, cells. Of raw view cells with the same set the first counts, boxes before shafts.
    """
    n = 0
    if boxes:
        # running sums over the useful cells: a node's key is a difference of two
        lo_sum, hi_sum = np.zeros(len(useful) + 1, dtype=np.uint64), np.zeros(len(useful) + 1, dtype=np.uint64)
        for j in range(len(useful)):
            lo_sum[j + 1] = lo_sum[j] + keys[j, 0]
            hi_sum[j + 1] = hi_sum[j] + keys[j, 1]
        # in preorder, and only nodes with useful cells: what the work grows with is the cells, not the tree
        waiting = [(0, 0, len(useful))]
        while len(waiting):
            node, a, b = waiting.pop()
            if _insert(table_key, table_id, slot_of, lo_sum[b] - lo_sum[a], hi_sum[b] - hi_sum[a], n) < 0:
                source[n, 0], source[n, 1], source[n, 2], source[n, 3] = -1, node, 0, b - a
                n += 1
            if tree_low[node] < 0:
                continue
            middle = a + np.searchsorted(useful[a:b], tree_start[tree_high[node]])
            if middle < b:
                waiting.append((tree_high[node], middle, b))
            if a < middle:
                waiting.append((tree_low[node], a, middle))
    if shafts:
        for j in range(len(useful)):
            box = cell_box[j]
            px = (box[0, 0] + box[1, 0]) / 2 - apex[0]
            py = (box[0, 1] + box[1, 1]) / 2 - apex[1]
            pz = (box[0, 2] + box[1, 2]) / 2 - apex[2]
            least = 0.7 * math.sqrt(px * px + py * py + pz * pz)  # cos 45 degrees = 0.707
            for d in range(len(directions)):
                hold[d, j] = 255
                if px * directions[d, 0] + py * directions[d, 1] + pz * directions[d, 2] < least:
                    continue
                a, k = shaft_class(apex, size, box, directions[d])
                if a >= 0:
                    hold[d, j] = DISTANCES * a + k
                    bucket[d, a, k, 0] += keys[j, 0]
                    bucket[d, a, k, 1] += keys[j, 1]
                    bucket_count[d, a, k] += 1
        for d in range(len(directions)):
            for a in range(4):
                lo, hi, m = np.uint64(0), np.uint64(0), 0
                for k in range(DISTANCES - 1, -1, -1):
                    # bucket (a, k) becomes what lies in angles <= a at distance k; lo, hi, m what lies at >= k
                    if a > 0:
                        bucket[d, a, k, 0] += bucket[d, a - 1, k, 0]
                        bucket[d, a, k, 1] += bucket[d, a - 1, k, 1]
                        bucket_count[d, a, k] += bucket_count[d, a - 1, k]
                    if bucket_count[d, a, k] == 0:
                        continue
                    lo += bucket[d, a, k, 0]
                    hi += bucket[d, a, k, 1]
                    m += bucket_count[d, a, k]
                    if _insert(table_key, table_id, slot_of, lo, hi, n) < 0:
                        source[n, 0], source[n, 1], source[n, 2], source[n, 3] = d, a, k, m
                        n += 1
            bucket[d] = 0
            bucket_count[d] = 0
    for i in range(n):
        table_id[slot_of[i]] = -1
    return n


@njit(cache=True)
def list_members(n, source, useful, hold, tree_start, tree_stop, row, member):
    """Fill row (S+1,) and member: the cells of set i, ascending places in `useful`, are member[row[i] : row[i + 1]]."""
    inside = np.zeros(256, dtype=np.bool_)
    row[0] = 0
    for i in range(n):
        at = row[i]
        d, angle, distance = source[i, 0], source[i, 1], source[i, 2]
        if d < 0:
            for j in range(np.searchsorted(useful, tree_start[angle]), np.searchsorted(useful, tree_stop[angle])):
                member[at] = j
                at += 1
        else:
            for h in range(4 * DISTANCES):
                inside[h] = h // DISTANCES <= angle and h % DISTANCES >= distance
            held = hold[d]
            for j in range(len(useful)):
                if inside[held[j]]:
                    member[at] = j
                    at += 1
        row[i + 1] = at


@njit(cache=True)
def cell_gains(view, cost, cell, excess, floor, useful, view_row, gain):
    """Group a cluster's pairs by cell: return the number of cells U, and fill the first U of

    useful    (P,) i64 the cells, ascending; view_row (P+1,) i64: cell i has pairs [view_row[i], view_row[i + 1])
    gain      (P,) i64: what the cheapest impostor could spare there, the sum of min(cost - floor, excess)
    from view, cost (P,) in order of view; cell, excess (V,) of every view.
    """
    n = 0
    for i in range(len(view)):
        v = view[i]
        if n == 0 or useful[n - 1] != cell[v]:
            useful[n], gain[n], view_row[n] = cell[v], 0, i
            n += 1
        gain[n - 1] += min(cost[i] - floor, excess[v])
    view_row[n] = len(view)
    return n


@njit(cache=True)
def raw_cells(source, apex, size, directions, tree_box, raw):
    """Fill raw (S,9): the view cells of the sets of `find_sets` as they were generated.

    tree_box  (K,2,3) boxes of the view-space tree's nodes
    """
    for i in range(len(source)):
        d, angle, distance = source[i, 0], source[i, 1], source[i, 2]
        for k in range(3):
            if d < 0:
                raw[i, k], raw[i, 3 + k], raw[i, 6 + k] = tree_box[angle, 0, k], tree_box[angle, 1, k], 0.0
            else:
                raw[i, k], raw[i, 3 + k] = apex[k], directions[d, k]
        if d >= 0:
            raw[i, 6], raw[i, 7], raw[i, 8] = _HALF_SIN[angle] / _HALF_COS[angle], size * 2.0**distance, np.inf


@njit(cache=True)
def weigh_sets(row, member, gain, cell_box, cluster, delta, dl, source, raw, weight, efficiency):
    """Fill for each set: weight (S,) f64 bytes by `weigh_quickly` for its bounding box, efficiency (S,) f64 gain a byte.

    A set that seems to need too many layers is out (infinite); with one cell it is looked at more patiently, so that no
    cell is lost.
    raw  (S,9) as `raw_cells` fills it: then they are weighed instead; or (0,9)
    """
    room = ROOM * MAX_LAYERS
    axes, frame, crop = np.empty((3, 3)), np.empty(10), np.empty((room, 2))
    plane, near, far = np.empty(room), np.empty(room), np.empty(room)
    cell = np.empty(9)
    for i in range(len(row) - 1):
        cells = member[row[i] : row[i + 1]]
        total = 0.0
        for k in cells:
            total += gain[k]
        if len(raw):
            shaft = source[i, 0] >= 0
            layers = lay_out_best(shaft, cluster, raw[i], delta, dl, axes, plane[:MAX_LAYERS], near, far, crop, frame)
            weight[i] = TEXEL_BYTES * frame[TEXELS] + IMPOSTOR_BYTES + LAYER_BYTES * layers if layers > 0 else np.inf
        else:
            wrap_box(cell_box, cells, cell)
            weight[i] = weigh_quickly(len(cells) == 1, cluster, cell, delta, dl, axes, plane, near, far, crop, frame)
        efficiency[i] = total / weight[i]


@njit(cache=True)
def is_needed(cells, gain, efficiency, held, above, share, outdone):
    """Return whether a set is worth a candidate beside those kept so far, all of which are at least as efficient.

    held   (U,) b1, cells of the sets kept so far
    above  (U,) efficiency of the best set of a larger cluster that holds each cell
    It is if `share` of its gain lies in cells that no set holds yet, and that no larger cluster serves `outdone` times as
    efficiently.
    """
    total = needed = 0.0
    for i in cells:
        total += gain[i]
        if not held[i] and above[i] <= outdone * efficiency:
            needed += gain[i]
    return needed > 0 and needed >= share * total


@njit(cache=True)
def fit_cell(kind, cluster, cell, delta, dl, screen, coefficient):
    """Lay the impostor out for a view cell (9,); return (bytes, layers, cost), layers <= 0 if there is none.

    coefficient  (3,) cost of an impostor, of one of its triangles, of one of its pixels
    """
    axes, frame, crop = np.empty((3, 3)), np.empty(10), np.empty((MAX_LAYERS, 2))
    plane, near, far = np.empty(MAX_LAYERS), np.empty(MAX_LAYERS), np.empty(MAX_LAYERS)
    layers = lay_out_best(kind == SHAFT, cluster, cell, delta, dl, axes, plane, near, far, crop, frame)
    if layers <= 0:
        return 0, layers, np.int64(0)
    weight = TEXEL_BYTES * int(frame[TEXELS]) + IMPOSTOR_BYTES + LAYER_BYTES * layers
    pixels = 0.0
    triangles = MAX_LAYER_TRIANGLES * layers
    for k in range(layers):
        unit = frame[TEXEL] * (plane[k] + frame[S])
        triangles += cut_triangles(crop[k, 0], crop[k, 1])
        pixels += rect_pixels(crop[k, 0] * unit, crop[k, 1] * unit, plane[k], screen)
    return weight, layers, impostor_cost(triangles, pixels, coefficient[0], coefficient[1], coefficient[2])


@njit(cache=True)
def fit_best(cluster, cell_box, cells, shafts, boxes, delta, dl, screen, coefficient, view_cell, points):
    """Fit view cells to a set and lay the impostor out; write view_cell (9,) and return (kind, bytes, layers, cost).

    The lighter of shaft and box, ties to the cheaper, then to the shaft; kind -1 if there is none.
    """
    cell, apex = np.empty(9), np.empty(3)
    best_kind, best_bytes, best_layers, best_cost = -1, 0, 0, np.int64(0)
    for kind in range(2):
        if kind == SHAFT:
            for k in range(3):
                apex[k] = (cluster[0, k] + cluster[1, k]) / 2
            if not shafts or not wrap_shaft(apex, cell_box, cells, points, cell):
                continue
        else:
            if not boxes:
                continue
            wrap_box(cell_box, cells, cell)
        weight, layers, cost = fit_cell(kind, cluster, cell, delta, dl, screen, coefficient)
        if layers <= 0:
            continue
        if best_kind < 0 or weight < best_bytes or (weight == best_bytes and cost < best_cost):
            best_kind, best_bytes, best_layers, best_cost = kind, weight, layers, cost
            view_cell[:] = cell
    return best_kind, best_bytes, best_layers, best_cost


@njit(cache=True)
def count_served(costs, view_row, cells, cost):
    """Return the number of pairs of the cells in which the cluster costs more than `cost`."""
    n = 0
    for i in cells:
        for k in range(view_row[i], view_row[i + 1]):
            if costs[k] > cost:
                n += 1
    return n


@njit(cache=True)
def list_served(views, costs, view_row, cells, cost, view, saved):
    """Write the views of those pairs, ascending where cells are, and what is saved in each."""
    n = 0
    for i in cells:
        for k in range(view_row[i], view_row[i + 1]):
            if costs[k] > cost:
                view[n], saved[n] = views[k], costs[k] - cost
                n += 1


@njit(cache=True)
def cells_inside(kind, view_cell, cell_box, out):
    """Write those of the cells that lie in a view cell, ascending; return how many."""
    n = 0
    for i in range(len(cell_box)):
        inside = True
        if kind == SHAFT:
            inside = shaft_holds(view_cell, cell_box[i])
        else:
            for k in range(3):
                inside &= view_cell[k] <= cell_box[i, 0, k] and cell_box[i, 1, k] <= view_cell[3 + k]
        if inside:
            out[n] = i
            n += 1
    return n


@njit(cache=True)
def choose_sets(
    order, row, member, gain, cell_box, cluster, shafts, boxes, delta, dl, screen, coefficient, costs, view_row,
    weight, efficiency, above, share, outdone, points, source, raw, inside, view_cell, number, served, reach,
):  # fmt: skip
    """Keep the sets that are needed, in `order`, fit them (or take `raw`, see `weigh_sets`), and let them serve whatever
    their view cell holds.

    Return how many. The outputs have a row for each:
    inside  (S,U) i32 its cells; view_cell (S,9); number (S,3) i64 kind, bytes, layers; served (S,3) i64 cost, cells, views
    reach   (U,) out: the greater of `above` and the efficiency of the best kept set that holds each cell
    No two have the same view cell: the second would find all its cells held.
    """
    held = np.zeros(len(above), dtype=np.bool_)
    count = 0
    reach[:] = above
    for i in order:
        if weight[i] == np.inf:
            break
        cells = member[row[i] : row[i + 1]]
        if not is_needed(cells, gain, efficiency[i], held, above, share, outdone):
            continue
        if len(raw):
            kind = SHAFT if source[i, 0] >= 0 else BOX
            view_cell[count] = raw[i]
            size, layers, cost = fit_cell(kind, cluster, raw[i], delta, dl, screen, coefficient)
        else:
            kind, size, layers, cost = fit_best(
                cluster, cell_box, cells, shafts, boxes, delta, dl, screen, coefficient, view_cell[count], points
            )
        if kind < 0:
            continue
        m = cells_inside(kind, view_cell[count], cell_box, inside[count])
        views = count_served(costs, view_row, inside[count, :m], cost)
        if views == 0:
            continue
        number[count, 0], number[count, 1], number[count, 2] = kind, size, layers
        served[count, 0], served[count, 1], served[count, 2] = cost, m, views
        for k in inside[count, :m]:
            held[k] = True
            reach[k] = max(reach[k], efficiency[i])
        count += 1
    return count
