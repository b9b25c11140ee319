"""Prices and shares for the lower bound from the linear programme whose dual it is, where that is small.

Problem  Minimise sum bytes x subject to, in each view: parts y <= x of what is offered, at most 1 along any path of nested
         clusters, saving the view's need together; 0 <= x <= 1.
Method   HiGHS. What a unit of need costs is a view's price, what a unit of y <= x costs an entry's share. Both come back
         rounded and may be slightly infeasible: `bound` proves its figure from them in integers, whatever they are.
"""

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import linprog

FEW_ENTRIES = 20_000  # a second or two
MOST_ENTRIES = 200_000  # minutes; at 300,000 HiGHS takes more than five


def dual_prices(
    row: np.ndarray, view: np.ndarray, saved: np.ndarray, *, cluster: np.ndarray, bytes: np.ndarray, need: np.ndarray,
    end: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:  # fmt: skip
    """Return (V,) f64 bytes that a unit of each view's need costs and (E,) f32 part of its bytes that each entry pays; or None.

    row, view, saved  as in Candidates; cluster, bytes  (N,); need  (V,) i64 >= 0; end  (C,) i32
    None: the solver found no optimum.
    """
    owner = np.repeat(np.arange(len(cluster)), np.diff(row))
    entry = np.flatnonzero(need[view] > 0)
    entry = entry[np.lexsort([owner[entry], cluster[owner[entry]], view[entry]])]
    at_view, at_owner = view[entry], owner[entry]
    n, m = len(cluster), len(entry)
    gain = np.minimum(saved[entry], need[at_view]) / need[at_view]
    path, member = _paths(at_view, cluster[at_owner], end)
    each, ones, n_paths = np.arange(m), np.ones(m), int(path.max(initial=-1)) + 1
    needy = np.flatnonzero(need > 0)
    limits = sparse.vstack([
        sparse.csr_matrix((-gain, (np.searchsorted(needy, at_view), n + each)), shape=(len(needy), n + m)),
        sparse.hstack([sparse.csr_matrix((-ones, (each, at_owner)), shape=(m, n)), sparse.eye(m)]),
        sparse.csr_matrix((np.ones(len(member)), (path, n + member)), shape=(n_paths, n + m)),
    ])  # fmt: skip
    unit = float(bytes.max())
    found = linprog(  # type: ignore[call-overload]  # its stubs know no sparse matrices
        np.concatenate([bytes / unit, np.zeros(m)]), A_ub=limits, bounds=(0, 1), method="highs-ds",
        b_ub=np.concatenate([-np.ones(len(needy)), np.zeros(m), np.ones(n_paths)]),
    )  # fmt: skip
    if found.status != 0:
        return None
    dual = np.maximum(-found.ineqlin.marginals, 0) * unit
    price, part = np.zeros(len(need)), np.zeros(len(view), np.float32)
    price[needy] = dual[: len(needy)] / need[needy]
    part[entry] = dual[len(needy) : len(needy) + m] / bytes[at_owner]
    return price, part


def _paths(view: np.ndarray, node: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (path, member) pairs: the entries, sorted by (view, node), along each longest chain of nested clusters."""
    path: list[int] = []
    member: list[int] = []
    chain: list[int] = []
    found = 0
    for e in range(len(view)):
        while chain and (view[chain[-1]] != view[e] or end[node[chain[-1]]] <= node[e]):
            chain.pop()
        chain.append(e)
        deeper = e + 1 < len(view) and view[e + 1] == view[e] and node[e + 1] < end[node[e]]
        if not deeper and len(chain) > 1:
            path += [found] * len(chain)
            member += chain
            found += 1
    return np.array(path, np.int64), np.array(member, np.int64)
