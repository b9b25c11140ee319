"""How far surfaces are apart, by looking at all triangles from many of their points; nothing is bounded."""

import numpy as np


def closest_on_triangle(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return (n,3): the point of triangle t (3,3) nearest to each p (n,3): of its plane if inside, else of its edges."""
    a, b, c = t
    found = [_on_segment(p, x, y) for x, y in ((a, b), (b, c), (c, a))]
    n = np.cross(b - a, c - a)
    if (n != 0).any():
        foot = p - ((p - a) @ n / (n @ n))[:, None] * n
        inside = np.ones(len(p), bool)
        for x, y in ((a, b), (b, c), (c, a)):
            inside &= np.cross(y - x, foot - x) @ n >= 0
        found.append(np.where(inside[:, None], foot, found[0]))
    distance = [((p - f) ** 2).sum(1) for f in found]
    return np.take_along_axis(np.array(found), np.argmin(distance, 0)[None, :, None], 0)[0]


def _on_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    d = b - a
    length2 = d @ d
    t = np.clip((p - a) @ d / length2, 0, 1) if length2 > 0 else np.zeros(len(p))
    return a + t[:, None] * d


def closest(p: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Return (n,3): the point of the surface (T,3,3) nearest to each of p (n,3)."""
    best, found = np.full(len(p), np.inf), np.empty_like(p)
    for t in surface:
        here = closest_on_triangle(p, t)
        d = ((p - here) ** 2).sum(1)
        found[d < best] = here[d < best]
        best = np.minimum(best, d)
    return found


def points_of(surface: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return points of the surface (T,3,3): its corners, middles of its edges and triangles, and n more by area."""
    area = np.linalg.norm(np.cross(surface[:, 1] - surface[:, 0], surface[:, 2] - surface[:, 0]), axis=1)
    t = surface[rng.choice(len(surface), n, p=area / area.sum())] if area.sum() > 0 else surface[:0]
    u = rng.random((len(t), 2))
    u = np.where(u.sum(1, keepdims=True) > 1, 1 - u, u)
    inner = t[:, 0] + u[:, :1] * (t[:, 1] - t[:, 0]) + u[:, 1:] * (t[:, 2] - t[:, 0])
    middles = (surface + np.roll(surface, 1, axis=1)).reshape(-1, 3) / 2
    return np.concatenate([surface.reshape(-1, 3), middles, surface.mean(1), inner])


def distance(a: np.ndarray, b: np.ndarray, n: int, rng: np.random.Generator) -> float:
    """Return a lower bound of the Hausdorff distance of two surfaces: of sampled points of both."""
    out = 0.0
    for x, y in ((a, b), (b, a)):
        p = points_of(x, n, rng)
        out = max(out, float(np.sqrt(((p - closest(p, y)) ** 2).sum(1)).max()))
    return out
