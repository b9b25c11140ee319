"""The output of stage 7."""

from dataclasses import dataclass, field

import numpy as np

SHAFT, BOX = 0, 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """N candidates: a cluster and a view cell from which an impostor of it is valid. Ids are final; ties go to the lower.

    Sorted by (cluster, kind, view cell). `view_cell` holds, for a SHAFT: apex (3), unit axis from object to viewer (3),
    tan(beta/2), near distance, far distance (may be inf), all along the axis from the apex; for a BOX: low (3), high (3),
    0, 0, 0. The problem views that candidate i helps are entries [row[i], row[i+1]).
    """

    cluster: np.ndarray  # (N,) i32  node of the hierarchy
    kind: np.ndarray  # (N,) u1   SHAFT or BOX
    view_cell: np.ndarray  # (N,9) f64
    bytes: np.ndarray  # (N,) i64  upper bound: 4 a texel of its layers, overhead an impostor and a layer
    layers: np.ndarray  # (N,) i32  upper bound
    cost: np.ndarray  # (N,) i64  upper bound of drawing it, from anywhere in its view cell
    row: np.ndarray  # (N+1,) i64
    view: np.ndarray  # (E,) i32  problem views served, ascending
    saved: np.ndarray  # (E,) i64  cost of the cluster's geometry in that view minus `cost`, > 0
    # (N,) i32  impostor of the base (`placement.base`) that it is, its bytes and cost measured; -1: none; (0,): no base
    base: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))


def take(candidates: Candidates, which: np.ndarray) -> Candidates:
    """Return the candidates of these ids (M,), ascending; id k of the result is which[k]."""
    first, count = candidates.row[which], np.diff(candidates.row)[which]
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    at = np.repeat(first - row[:-1], count) + np.arange(row[-1])
    return Candidates(
        cluster=candidates.cluster[which], kind=candidates.kind[which], view_cell=candidates.view_cell[which],
        bytes=candidates.bytes[which], layers=candidates.layers[which], cost=candidates.cost[which], row=row,
        view=candidates.view[at], saved=candidates.saved[at],
        base=candidates.base[which] if len(candidates.base) else candidates.base,
    )  # fmt: skip
