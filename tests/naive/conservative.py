"""Sight lines and orientation without any trick, for tests of mode `conservative`."""

from fractions import Fraction

import numpy as np


def orient2d(ax, ay, bx, by, cx, cy):
    ax, ay, bx, by, cx, cy = map(Fraction, (ax, ay, bx, by, cx, cy))
    d = (ax - cx) * (by - cy) - (ay - cy) * (bx - cx)
    return (d > 0) - (d < 0)


def is_free(p, q, corner, two_sided, *, touch=1e-9):
    """Does the segment p -> q meet no triangle (T,3,3)? One that comes as near as `touch` of its size to an edge is met;
    within `touch` of either end nothing is. Fronts are counterclockwise."""
    p, d = np.asarray(p, float), np.asarray(q, float) - np.asarray(p, float)
    e1, e2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    h = np.cross(d, e2)
    det = (e1 * h).sum(1)
    parallel = np.abs(det) <= 1e-15 * np.sqrt((e1 * e1).sum(1) * (h * h).sum(1))
    f = 1.0 / np.where(parallel, 1.0, det)
    s = p - corner[:, 0]
    u = f * (s * h).sum(1)
    k = np.cross(s, e1)
    v, t = f * (k @ d), f * (e2 * k).sum(1)
    met = ~parallel & (u >= -touch) & (v >= -touch) & (u + v <= 1 + touch) & (t > touch) & (t < 1 - touch)
    met &= two_sided | (det > 0)
    return not met.any()
