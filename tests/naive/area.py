"""Slow, obvious shares of texels: every point against every piece, every texel against every layer."""

import numpy as np
from farfield.bake.records import Pieces, Slabs, Sources


def owners(sources: Sources, pieces: Pieces, k: int, i: int, j: int) -> list[int]:
    """Return, for the 16 points of texel (i, j) of layer k, the nearest piece that covers it, -1 if none."""
    out = []
    for y in range(4):
        for x in range(4):
            p = np.array([256 * i + 32 + 64 * x, 256 * j + 32 + 64 * y], float)
            best, nearest = -1, -np.inf
            for f in range(pieces.row[k], pieces.row[k + 1]):
                a, b, c = pieces.snapped[f].reshape(3, 2).astype(float)
                sides = [_cross(b - a, p - a), _cross(c - b, p - b), _cross(a - c, p - c)]
                if _cross(b - a, c - a) == 0 or (min(sides) < 0 < max(sides)):
                    continue
                s = pieces.source[f]
                q = sources.snapped[s].reshape(3, 2).astype(float)
                m = np.array([q[1] - q[0], q[2] - q[0]])
                if abs(np.linalg.det(m)) == 0:
                    inverse = sources.inverse[s, 0]
                else:
                    v = sources.inverse[s]
                    inverse = v[0] + (p - q[0]) @ np.linalg.solve(m, np.array([v[1] - v[0], v[2] - v[0]]))
                if inverse > nearest:
                    best, nearest = f, inverse
            out.append(best)
    return out


def _cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def composed(
    slabs: Slabs, start: np.ndarray, rgba: np.ndarray, points: np.ndarray, beside: np.ndarray, decode: np.ndarray,
    encode_srgb: object,
) -> np.ndarray:  # fmt: skip
    """Return what `area.compose` does, texel by texel, in words of sets."""
    at: list[dict[tuple[int, int], int]] = []
    for k in range(len(slabs.size)):
        (x0, y0), (w, h) = slabs.low[k].tolist(), slabs.size[k].tolist()
        at.append({
            (x0 + x, y0 + y): int(start[k]) + y * w + x for y in range(h) for x in range(w)
            if rgba[start[k] + y * w + x, 3]
        })  # fmt: skip
    bits = lambda t: {b for b in range(16) if int(points[t]) >> b & 1}  # noqa: E731
    out = np.zeros_like(rgba)
    for k, texels in enumerate(at):
        for place, t in texels.items():
            adjoining = []
            for step in (-1, 1):
                m = k + step
                while 0 <= m < len(at) and place in at[m]:
                    adjoining.append(at[m][place])
                    m += step
            own, quarters = bits(t), max(1, (len(bits(t)) + 2) // 4)
            parts, left = [(t, len(own))], set(range(16)) - own
            for u in adjoining:
                parts.append((u, len(left & bits(u))))
                left -= bits(u)
            n = sum(m for _, m in parts)
            full = bool(adjoining) or bool(beside[t])
            mean = sum(decode[rgba[u, :3]] * m for u, m in parts) / n if n else None
            out[t, :3] = encode_srgb(mean) if full and n else rgba[t, :3]  # type: ignore[operator]
            (i, j), others = place, [at[m] for m in range(len(at)) if m != k]
            around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
            both_end = any(len(bits(o[p])) < 16 for o in others for p in around if p in o)
            out[t, 3] = 4 * (int(rgba[t, 3]) - 1) + (4 if full or both_end else quarters)
    return out
