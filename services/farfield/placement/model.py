"""The output of stage 8, and of its shards where the view space is optimised in regions."""

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """I chosen impostors and what each of V problem views shows. Impostor ids ascend with (cluster, kind, view cell).

    View v shows impostors serve[serve_row[v], serve_row[v+1]), ascending; their clusters are disjoint; everything else
    in the view is drawn as geometry. The view cell of an impostor covers every cell in which it is shown.
    """

    cluster: np.ndarray  # (I,) i32
    kind: np.ndarray  # (I,) u1
    view_cell: np.ndarray  # (I,9) f64  as in Candidates, re-tightened to what is served
    bytes: np.ndarray  # (I,) i64  as in Candidates; measured after `repair`
    layers: np.ndarray  # (I,) i32
    cost: np.ndarray  # (I,) i64
    serve_row: np.ndarray  # (V+1,) i64
    serve: np.ndarray  # (S,) i32
    view_cost: np.ndarray  # (V,) i64  bound with the impostors shown, re-evaluated from scratch
    view_target: np.ndarray  # (V,) i64  model.target, or what the policy says for a hopeless view
    view_best: np.ndarray  # (V,) i64  least cost that any combination of candidates reaches
    hopeless: np.ndarray  # (V,) b1   view_best > model.target
    culprit_row: np.ndarray  # (H+1,) i64  for the h-th hopeless view (ascending): objects to blame ...
    culprit: np.ndarray  # (U,) i32  ... most expensive first, at most 16
    smallest_budget: int  # least budget (with per_frame) that every view could meet
    curve_budget: np.ndarray  # (K,) i64  memory over budget, see `curve`: budgets (with per_frame), ascending ...
    curve_bytes: (
        np.ndarray
    )  # (K,) i64  ... bytes that were found to suffice there (estimates, like `bytes` before `repair`) ...
    curve_over: np.ndarray  # (K,) i64  ... for all problem views but so many
    stopped: bool  # a wall-clock limit cut the search short: another run may end elsewhere
    # (I,) i32  impostor of the base (`placement.base`) that it is, -1: to be baked; (0,) without a base
    base: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))


def fresh_of(placement: Placement) -> np.ndarray:
    """Return the impostors (F,) i64 that no base has baked, ascending: all of them where there is none."""
    return np.flatnonzero(placement.base < 0) if len(placement.base) else np.arange(len(placement.cluster))


def only_fresh(placement: Placement) -> Placement:
    """Return the placement with the impostors that are to be baked alone, shown nowhere: what the bake reads."""
    if not len(placement.base):
        return placement
    of_impostor = ("cluster", "kind", "view_cell", "bytes", "layers", "cost", "base")
    fresh = fresh_of(placement)
    return replace(
        placement, **{name: getattr(placement, name)[fresh] for name in of_impostor}, serve=placement.serve[:0],
        serve_row=np.zeros_like(placement.serve_row),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """What no placement can weigh less than: of the candidates and these impostors, any choice that meets all targets."""

    method: str  # "lp", "lagrangian", or "none"
    lower_bytes: int  # 0 where there is none
    placed_bytes: int  # of the placement, estimated before the bake as the bound is
    choices: int  # candidates and impostors that the bound speaks of


@dataclass(frozen=True, slots=True, kw_only=True)
class RegionChoice:
    """What one region chose, to choose among once more."""

    candidate: np.ndarray  # (M,) i32  ascending
    stopped: bool  # as in Placement
