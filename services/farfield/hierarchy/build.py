"""Build the cluster hierarchy: the binary Morton tree of the objects' boxes on the fixed grid.

Problem  A binary tree over objects in their id order, whose clusters are compact in space; moving one object then
         changes only the clusters that it leaves or enters.
Method   The radix tree of the Morton keys that fixed the id order (`farfield.scene.order`): a range is cut where the
         highest bit in which its keys differ changes, that is, at the coarsest grid plane that separates its centres.
         Objects whose centres share a grid cell (a thousandth of a view cell) are cut in the middle of their range.
         It is at most 126 + log2 N deep.
After    Karras. Maximizing Parallelism in the Construction of BVHs, Octrees, and k-d Trees. HPG 2012, section 3.
"""

import numpy as np

from farfield.hierarchy import kernels
from farfield.hierarchy.model import Hierarchy
from farfield.scene.model import Scene
from farfield.scene.order import morton_keys


def build_hierarchy(scene: Scene) -> Hierarchy:
    """Return the 2 N - 1 clusters over the N >= 1 objects of `scene`, which stand in Morton order."""
    n = scene.n_objects
    assert n > 0
    key = morton_keys(scene.object_box, origin_m=scene.origin_m, cell_m=scene.cell_m)
    high, low = np.ascontiguousarray(key[:, 0]), np.ascontiguousarray(key[:, 1])
    assert np.all((high[:-1] < high[1:]) | ((high[:-1] == high[1:]) & (low[:-1] <= low[1:]))), "objects not in id order"
    start, stop, left, right, parent = (np.empty(2 * n - 1, dtype=np.int32) for _ in range(5))
    kernels.radix_tree(high, low, start, stop, left, right, parent)

    leaf = left < 0
    box = np.empty((2 * n - 1, 2, 3))
    box[:, 0], box[:, 1] = np.inf, -np.inf
    box[leaf] = scene.object_box
    sums = []
    for column in (scene.object_calls, scene.object_triangles, scene.object_bytes):
        total = np.zeros(2 * n - 1, dtype=np.int64)
        total[leaf] = column
        sums.append(total)
    calls, triangles, size_bytes = sums
    replaceable = np.ones(2 * n - 1, dtype=np.bool_)
    replaceable[leaf] = scene.object_replaceable
    kernels.gather(parent, box, calls, triangles, size_bytes, replaceable)
    return Hierarchy(
        start=start, stop=stop, left=left, right=right, parent=parent, box=box, calls=calls, triangles=triangles,
        bytes=size_bytes, replaceable=replaceable,
    )  # fmt: skip
