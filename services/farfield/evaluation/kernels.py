"""Numba kernels of `verify`: what one camera sees of boxes and polygons, by clipping against its pyramid.

A box and the view pyramid are convex and the pyramid is unbounded, so they meet iff a face of the box meets the pyramid
or the eye is in the box: no separating axes, and nothing shared with the stages that are checked. Coordinates are
(x / tan_x, y / tan_y, z) in the camera's frame: inside is z >= |x|, |y|.
"""

import numpy as np
from numba import njit

# The faces of a box as corners k = 4 x + 2 y + z (0 low, 1 high), around each face.
FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], dtype=np.int64
)  # fmt: skip


@njit(cache=True)
def inside_of(p, plane):
    """Return z - x, z + x, z - y or z + y: how far inside the plane of the pyramid."""
    c = p[plane // 2]
    return p[2] - c if plane % 2 == 0 else p[2] + c


@njit(cache=True)
def clip_to_pyramid(points, n, spare):
    """Clip the convex polygon points[:n] in place (capacity >= n + 4; `spare` alike); return its number of corners."""
    for plane in range(4):
        m = 0
        for k in range(n):
            p, q = points[k], points[(k + 1) % n]
            dp, dq = inside_of(p, plane), inside_of(q, plane)
            if dp >= 0:
                spare[m] = p
                m += 1
            if (dp > 0 and dq < 0) or (dp < 0 and dq > 0):
                t = dp / (dp - dq)
                for c in range(3):
                    spare[m, c] = p[c] + t * (q[c] - p[c])
                m += 1
        n = m
        if n == 0:
            break
        for k in range(n):
            points[k] = spare[k]
    return n


@njit(cache=True)
def to_camera(p, eye, frame, out):
    for a in range(3):
        s = 0.0
        for c in range(3):
            s += (p[c] - eye[c]) * frame[a, c]
        out[a] = s


@njit(cache=True)
def screen_share(points, n, rect):
    """Return the share of the screen that the clipped polygon's projection covers, and widen its rectangle (4,)."""
    area = 0.0
    for k in range(n):
        p, q = points[k], points[(k + 1) % n]
        if p[2] <= 0 or q[2] <= 0:  # a corner at the eye: no bound but the whole screen
            rect[0], rect[1], rect[2], rect[3] = -1.0, 1.0, -1.0, 1.0
            return 1.0
        x, y = p[0] / p[2], p[1] / p[2]
        rect[0], rect[1] = min(rect[0], x), max(rect[1], x)
        rect[2], rect[3] = min(rect[2], y), max(rect[3], y)
        area += x * (q[1] / q[2]) - y * (q[0] / q[2])
    return abs(area) / 8  # the screen is [-1, 1] squared


@njit(cache=True)
def box_share(box, eye, frame, points, spare, corners):
    """Return the share of the screen of the box's bounding rectangle there; -1 where the camera sees none of the box.

    frame    (3,3) f64  rows right / tan_x, up / tan_y, forward
    """
    within = True
    for c in range(3):
        if eye[c] < box[0, c] or eye[c] > box[1, c]:
            within = False
    if within:
        return 1.0
    outside = np.zeros(4, dtype=np.int64)
    p = np.empty(3)
    for k in range(8):
        p[0], p[1], p[2] = box[k // 4, 0], box[k // 2 % 2, 1], box[k % 2, 2]
        to_camera(p, eye, frame, corners[k])
        for plane in range(4):
            if inside_of(corners[k], plane) < 0:
                outside[plane] += 1
    for plane in range(4):
        if outside[plane] == 8:
            return -1.0
    rect = np.array([np.inf, -np.inf, np.inf, -np.inf])
    seen = False
    for f in range(6):
        for k in range(4):
            points[k] = corners[FACES[f, k]]
        n = clip_to_pyramid(points, 4, spare)
        if n > 0:
            seen = True
            screen_share(points, n, rect)
    return (rect[1] - rect[0]) * (rect[3] - rect[2]) / 4 if seen else -1.0


@njit(cache=True)
def boxes_share(boxes, ids, eye, frame, out):
    """Write `box_share` of boxes[ids] to `out`."""
    points, spare, corners = np.empty((16, 3)), np.empty((16, 3)), np.empty((8, 3))
    for k in range(len(ids)):
        out[k] = box_share(boxes[ids[k]], eye, frame, points, spare, corners)


@njit(cache=True)
def polygons_share(corner, row, eye, frame):
    """Return the sum of the shares of the screen of polygons (CSR, up to 8 corners each, same frame as eye)."""
    points, spare = np.empty((16, 3)), np.empty((16, 3))
    rect = np.zeros(4)
    total = 0.0
    for r in range(len(row) - 1):
        n = row[r + 1] - row[r]
        for k in range(n):
            to_camera(corner[row[r] + k], eye, frame, points[k])
        n = clip_to_pyramid(points, n, spare)
        if n >= 3:
            total += screen_share(points, n, rect)
    return total


@njit(cache=True)
def _edge_squared(p, a, b):
    """Return the squared distance of p from the segment ab."""
    squared = along = 0.0
    for i in range(3):
        e = b[i] - a[i]
        squared += e * e
        along += e * (p[i] - a[i])
    t = min(max(along / squared, 0.0), 1.0) if squared > 0 else 0.0
    out = 0.0
    for i in range(3):
        d = p[i] - a[i] - t * (b[i] - a[i])
        out += d * d
    return out


@njit(cache=True)
def surface_within(point, limit, corner, found):
    """Fill found (N,) b1: whether a triangle of corner (T,3,3) lies within limit (N,) of the point (N,3), edge-on or not."""
    for n in range(len(point)):
        p, reach = point[n], limit[n]
        found[n] = False
        for k in range(len(corner)):
            a, b, c = corner[k, 0], corner[k, 1], corner[k, 2]
            away = False
            for i in range(3):
                if min(a[i], b[i], c[i]) > p[i] + reach or max(a[i], b[i], c[i]) < p[i] - reach:
                    away = True
                    break
            if away:
                continue
            nearest = min(_edge_squared(p, a, b), _edge_squared(p, b, c), _edge_squared(p, c, a))
            ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
            wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area = nx * nx + ny * ny + nz * nz
            if area > 0:
                # weights of b and c of the foot of the perpendicular
                s = ((wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz) / area
                t = ((uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz) / area
                if s >= 0 and t >= 0 and s + t <= 1:
                    height = wx * nx + wy * ny + wz * nz
                    nearest = min(nearest, height * height / area)
            if nearest <= reach * reach:
                found[n] = True
                break


@njit(cache=True)
def beyond_a_plane(box, eye, frame):
    """Return whether the box lies outside one plane of the pyramid by more than rounding: `box_share` is -1 then."""
    for plane in range(4):
        sign = -1.0 if plane % 2 == 0 else 1.0
        most = size = 0.0
        for c in range(3):
            a, b = box[0, c] - eye[c], box[1, c] - eye[c]
            slope = frame[2, c] + sign * frame[plane // 2, c]
            most += max(slope * a, slope * b)
            size += (abs(frame[2, c]) + abs(frame[plane // 2, c])) * max(abs(a), abs(b))
        if most < -1e-12 * size:
            return True
    return False


@njit(cache=True)
def wholly_inside(box, eye, frame):
    """Return whether all corners of the box lie within all planes of the pyramid: it is drawn, then."""
    for plane in range(4):
        sign = -1.0 if plane % 2 == 0 else 1.0
        least = 0.0
        for c in range(3):
            slope = frame[2, c] + sign * frame[plane // 2, c]
            least += min(slope * (box[0, c] - eye[c]), slope * (box[1, c] - eye[c]))
        if least < 0:
            return False
    return True


@njit(cache=True)
def cameras_share(boxes, ids, eyes, frames, fixed, pixel, largest):
    """Widen `largest` (n,) to the largest share of each of boxes[ids] over all cameras (-1: none sees it); return the
    cost of the dearest camera: `fixed` (n,) of what it sees, and `pixel` times its shares.

    Where pixel is 0 shares are not wanted, only whether: 0 stands for seen.
    """
    points, spare, corners = np.empty((16, 3)), np.empty((16, 3)), np.empty((8, 3))
    worst = 0.0
    for s in range(len(eyes)):
        cost = 0.0
        for k in range(len(ids)):
            box = boxes[ids[k]]
            if beyond_a_plane(box, eyes[s], frames[s]):
                continue
            if pixel == 0 and wholly_inside(box, eyes[s], frames[s]):
                share = 0.0
            else:
                share = box_share(box, eyes[s], frames[s], points, spare, corners)
                if share < 0:
                    continue
            cost += fixed[k] + pixel * share
            largest[k] = max(largest[k], share)
        worst = max(worst, cost)
    return worst
