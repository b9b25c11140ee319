"""Views of a placement in its own terms: directions of its intervals, positions in its view space.

As docs/formats/placementdb.md numbers them; `verify` must share nothing with the stages that it judges.
"""

import numpy as np

from farfield.placementdb.read import Placement


def direction_in(placement: Placement, interval: int, share_u: float = 0.5, share_v: float = 0.5) -> np.ndarray:
    """Return the direction (3,) f64, not normalised, at shares [0, 1] of the interval's two ratios; its middle."""
    edges = placement.manifest["interval_edges"]
    n = len(edges) - 1
    face, j, i = interval // (n * n), interval // n % n, interval % n
    direction = np.empty(3)
    direction[face // 2] = -1.0 if face % 2 else 1.0
    direction[(face // 2 + 1) % 3] = edges[i] + (edges[i + 1] - edges[i]) * share_u
    direction[(face // 2 + 2) % 3] = edges[j] + (edges[j + 1] - edges[j]) * share_v
    return direction


def into(boxes: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the nearest point of the view space (B,2,3): a cell's bounding box may hold points that no box of it does."""
    inside = np.clip(position, boxes[:, 0], boxes[:, 1])
    return np.asarray(inside[int(np.argmin(((inside - position) ** 2).sum(1)))])
