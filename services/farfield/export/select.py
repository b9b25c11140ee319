"""Which impostors to export, and in which cells, intervals and problem views each of them is shown.

Problem  A placement shows an impostor in some hundred views of some ten cells; lists of lists would outweigh its texels.
Method   Chunk by chunk, each opened afresh so that none stays in memory; ids as runs [first, stop), which cells and
         problem views of one impostor mostly are.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from farfield.errors import NothingToExport, SettingsInvalid
from farfield.placementdb.read import Placement

Runs = list[list[int]]


@dataclass(slots=True, kw_only=True)
class Shown:
    """Where one impostor is shown. Runs are half-open and ascending."""

    cells: Runs = field(default_factory=list)
    intervals: set[int] = field(default_factory=set)
    views: Runs = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What is exported."""

    name: str  # of the scene
    shown: dict[int, Shown]  # impostor id -> where, ids ascending
    cells: list[int]  # cells whose views show some of them, ascending
    impostors_of: dict[int, list[int]]  # cell -> impostor ids shown in any of its views, ascending


def fresh(placement: Placement) -> Placement:
    """Return the placement without what it remembers of its chunks."""
    return Placement(placement.folder, placement.manifest, placement.index)


def select_all(placement: Placement) -> Selection:
    """Return every impostor that some view shows. Raises NothingToExport."""
    return _select(placement, "all impostors", range(len(placement.manifest["chunks"])), None, None)


def select_cell(placement: Placement, cell: int) -> Selection:
    """Return what the views of one leaf cell show. Raises SettingsInvalid, NothingToExport."""
    n = placement.manifest["counts"]["cells"]
    if not 0 <= cell < n:
        raise SettingsInvalid("--cell", f"must be in 0..{n - 1}: the placement has {n} cells")
    return _select(placement, f"cell {cell}", _chunks_of(placement, cell), cell, None)


def select_view(placement: Placement, position: Sequence[float], direction: Sequence[float]) -> Selection:
    """Return what is shown at a position looking in a direction (3, scene metres).

    Raises OutsideViewSpace, DirectionInvalid, NothingToExport.
    """
    cell, interval = placement.find_cell(position), placement.find_interval(direction)
    return _select(placement, f"cell {cell} interval {interval}", _chunks_of(placement, cell), cell, interval)


def _chunks_of(placement: Placement, cell: int) -> list[int]:
    k = placement.chunk_of(cell)
    return [] if k is None else [k]


def _select(
    placement: Placement, name: str, chunks: Iterable[int], cell: int | None, interval: int | None
) -> Selection:
    shown: dict[int, Shown] = {}
    impostors_of: dict[int, list[int]] = {}
    for k in chunks:
        columns = fresh(placement).chunk(k)
        first_cell, first_view = (placement.manifest["chunks"][k][key][0] for key in ("cells", "views"))
        for c in range(len(columns["cell_view"]) - 1):
            if cell is not None and first_cell + c != cell:
                continue
            here: set[int] = set()
            for v in range(int(columns["cell_view"][c]), int(columns["cell_view"][c + 1])):
                at = int(columns["view_interval"][v])
                if interval is not None and at != interval:
                    continue
                a, b = columns["list_row"][columns["view_list"][v] :][:2]
                ids = columns["impostor_id"][columns["list_impostor"][a:b]].tolist()
                for i in ids:
                    of = shown.setdefault(i, Shown())
                    _extend(of.cells, first_cell + c)
                    _extend(of.views, first_view + v)
                    of.intervals.add(at)
                here.update(ids)
            if here:
                impostors_of[first_cell + c] = sorted(here)
    if not shown:
        raise NothingToExport(name)
    return Selection(
        name=name, shown=dict(sorted(shown.items())), cells=sorted(impostors_of), impostors_of=impostors_of
    )  # fmt: skip


def _extend(runs: Runs, value: int) -> None:
    """Add a value that is not below the last one."""
    if runs and value <= runs[-1][1]:
        runs[-1][1] = max(runs[-1][1], value + 1)
    else:
        runs.append([value, value + 1])


def runs_of(values: Iterable[int]) -> Runs:
    """Return ascending runs [first, stop) of a set of integers."""
    runs: Runs = []
    for value in sorted(values):
        _extend(runs, value)
    return runs
