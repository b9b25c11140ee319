"""The output of stage 5, and that of one of its shards."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


def _no_cells() -> np.ndarray:
    return np.zeros(0, dtype=np.int32)


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleSets:
    """The objects that each leaf cell can see. With mode "off" both arrays are empty and every cell sees every object.

    A closed cell (without a free camera point) has the objects that meet its box. The rest says how far the sets are to
    be trusted: a missed pixel, counted a million, shows an object that its cell's set lacks. The
    held-out rays and views were drawn evenly over the free part of the view space, by no rule that knows the sets.
    """

    mode: str  # "off", "sampled" or "conservative"
    row: np.ndarray  # (L+1,) i64, or (0,) when off
    object: np.ndarray  # (E,) i32  sorted within a row
    closed: np.ndarray = field(default_factory=_no_cells)  # (Z,) i32  cells without a free camera point
    rays: int = 0  # traced to find the sets, those that were held out not among them
    rule: str = ""  # what makes a camera point free: "sky", "facing" or "any", see farfield.visibility.free
    occluders: tuple[str, ...] = ()  # "conservative": what is taken to hide something and what not, and why
    seen_share: float | None = None  # of the objects' cost, that "auto" found a cell to see; None: not asked
    held_out: int = 0  # rays
    held_out_missed: int = 0
    missed_ppm_upper: float | None = None  # 95 % bound; None: nothing held out
    views: int = 0  # random views of 45 degrees
    p99_ppm: float | None = None  # in the view that 99 % of them do not exceed
    worst_ppm: float | None = None


def off() -> VisibleSets:
    """Return the sets of a stage that was skipped."""
    return VisibleSets(mode="off", row=np.zeros(0, np.int64), object=_no_cells())


def summary(visible: VisibleSets, *, n_objects: int) -> dict[str, Any]:
    """Return what the report says of the sets, as JSON values; "mean_objects" is how many a cell sees."""
    cells = len(visible.row) - 1
    figures = ("mode", "rule", "seen_share", "rays", "held_out", "held_out_missed", "missed_ppm_upper", "views", "p99_ppm",
               "worst_ppm")  # fmt: skip
    return {
        **{name: getattr(visible, name) for name in figures},
        "occluders": list(visible.occluders), "closed_cells": len(visible.closed),
        "mean_objects": round(len(visible.object) / cells, 1) if cells > 0 else float(n_objects),
    }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """What one shard found: sets as bits over the cells its lines touched, and what it held out for the merge.

    Object o of a set is bit o % 64 of word o // 64. Held-out rays and views are pairs (cell, object) with how many rays.
    """

    mode: str
    rule: str
    occluders: tuple[str, ...]
    seen_share: float | None
    cell: np.ndarray  # (C,) i32  ascending
    bits: np.ndarray  # (C,W) u64
    closed: np.ndarray  # (Z,) i32
    rays: int
    held_cell: np.ndarray  # (H,) i32
    held_object: np.ndarray  # (H,) i32
    held_count: np.ndarray  # (H,) i64
    held_out: int
    view_row: np.ndarray  # (V+1,) i64  pairs of view v
    view_cell: np.ndarray  # (V,) i32
    view_object: np.ndarray  # (G,) i32
    view_count: np.ndarray  # (G,) i64
