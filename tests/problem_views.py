"""ProblemViews written down by hand, for tests: from the objects of each view and what each costs there."""

import numpy as np
from farfield.viewspace.model import ProblemViews


def views_of(cell, interval, objects, costs):
    """ProblemViews of V views. objects: the ascending ids that each shows; costs (V,N): of every object, in each view."""
    costs = np.asarray(costs, dtype=np.int64)
    run, before, row, total = [], [], [0], []
    for seen, cost in zip(objects, costs):
        spent = 0
        for k, o in enumerate(seen):
            if k == 0 or o != seen[k - 1] + 1:
                run.append([o, o])
                before.append(spent)
            run[-1][1] = o + 1
            spent += int(cost[o])
        row.append(len(run))
        total.append(spent)
    n_views, n_objects = costs.shape
    return ProblemViews(
        cell=np.asarray(cell, dtype=np.int32), interval=np.asarray(interval, dtype=np.int32),
        cost=np.array(total, dtype=np.int64), row=np.array(row, dtype=np.int64),
        run=np.array(run, dtype=np.int32).reshape(-1, 2), before=np.array(before, dtype=np.int64),
        list=np.arange(n_views, dtype=np.int32), list_row=np.arange(n_views + 1, dtype=np.int64) * n_objects,
        list_object=np.tile(np.arange(n_objects, dtype=np.int32), n_views),
        list_through=np.cumsum(costs, axis=1).reshape(-1), cell_cost=np.zeros(0, np.int64), worst_nonproblem=0,
    )  # fmt: skip
