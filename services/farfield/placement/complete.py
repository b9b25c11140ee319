"""Add the candidates that hopeless views lack, so that hopeless means: whatever is built.

Problem  Candidates were thinned out: with other sets of cells a view that they cannot bring to the budget might be.
Method   For the cells of such views, the worst first, every cluster is fitted to that cell alone (`candidates.alone`):
         nothing that is valid there costs less. Where the best antichain of these and all others is better than before,
         those in it join the candidates, for rescue and greedy alike.
Errs     After MOST_FITTED fits the other cells stay as they are: some views may then be called hopeless that are not.
         The worst ones are exact, and the smallest budget with them unless every cell that was left out is as bad.
"""

from collections.abc import Sequence

import numpy as np

from farfield.candidates.alone import Alone
from farfield.candidates.model import Candidates, take
from farfield.placement.antichain import best_antichain, best_in_views, cheapest_offers
from farfield.viewspace.model import ProblemViews

MOST_FITTED = 200_000  # about 10 s


def complete(
    candidates: Candidates, views: ProblemViews, *, target: int, end: np.ndarray, alone: Alone,
    most_fitted: int = MOST_FITTED,
) -> Candidates:  # fmt: skip
    """Return the candidates with those for single cells that bring views nearer which cannot cost `target` or less.

    end  (C,) i32, see `antichain.subtree_end`
    """
    row, id, saved = cheapest_offers(
        candidates.cluster, candidates.row, candidates.view, candidates.saved, len(views.cell)
    )
    best = best_in_views(row, id, saved, candidates.cluster, end, np.empty(len(id), dtype=bool))
    lacks = views.cost - best
    hopeless = np.flatnonzero(lacks > target)
    cells, of_cell = np.unique(views.cell[hopeless], return_inverse=True)
    worst = np.zeros(len(cells), np.int64)
    np.maximum.at(worst, of_cell, lacks[hopeless])
    added: list[Candidates] = []
    fitted = 0
    for k in np.argsort(-worst, kind="stable"):
        if fitted >= most_fitted:
            break
        more = alone(int(cells[k]))
        fitted += len(more.cluster)
        wanted = np.zeros(len(more.cluster), dtype=bool)
        owner = np.repeat(np.arange(len(more.cluster)), np.diff(more.row))
        for v in hopeless[of_cell == k]:
            at = slice(row[v], row[v + 1])
            here = more.view == v
            cluster = np.concatenate([candidates.cluster[id[at]], more.cluster[owner[here]]])
            order = np.argsort(cluster, kind="stable")  # what is there already before what would join it
            saves = np.concatenate([saved[at], more.saved[here]])[order]
            taken = np.empty(len(order), dtype=bool)
            stack = np.empty(len(order), np.int32), np.empty(len(order), np.int64)
            if best_antichain(cluster[order], saves, end, taken, *stack) > best[v]:
                fresh = order[taken] - (row[v + 1] - row[v])
                wanted[owner[here][fresh[fresh >= 0]]] = True
        if wanted.any():
            added.append(take(more, np.flatnonzero(wanted)))
    return _joined(candidates, added) if added else candidates


def _joined(candidates: Candidates, added: Sequence[Candidates]) -> Candidates:
    """Return all candidates, sorted by cluster; of one cluster, first those that were there."""
    join = lambda name: np.concatenate([getattr(a, name) for a in added])  # noqa: E731
    offset = np.cumsum([0, *(a.row[-1] for a in added)])
    row = np.concatenate([[0], *(a.row[1:] + o for a, o in zip(added, offset[:-1], strict=True))]).astype(np.int64)
    more = Candidates(
        cluster=join("cluster"), kind=join("kind"), view_cell=join("view_cell"), bytes=join("bytes"),
        layers=join("layers"), cost=join("cost"), row=row, view=join("view"), saved=join("saved"),
    )  # fmt: skip
    more = take(more, np.argsort(more.cluster, kind="stable"))
    at = np.searchsorted(candidates.cluster, more.cluster, side="right")
    put = lambda name: np.insert(getattr(candidates, name), at, getattr(more, name), axis=0)  # noqa: E731
    count = np.diff(more.row)
    base = np.insert(candidates.base, at, -1) if len(candidates.base) else candidates.base
    entry = np.repeat(candidates.row[at], count)
    return Candidates(
        cluster=put("cluster"), kind=put("kind"), view_cell=put("view_cell"), bytes=put("bytes"), layers=put("layers"),
        cost=put("cost"), row=np.cumsum(np.concatenate([[0], np.insert(np.diff(candidates.row), at, count)])),
        view=np.insert(candidates.view, entry, more.view), saved=np.insert(candidates.saved, entry, more.saved), base=base,
    )  # fmt: skip
