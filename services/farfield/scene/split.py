"""Split what is larger than two cells: a mesh that is a whole level, a terrain.

Problem  An object stands for one draw call and one box. One that spans many cells is near every camera, and no impostor
         of it is ever valid. Cut it, but not into crumbs: a draw call costs as much as some 2,000 triangles. (Where the
         budget is in triangles a call costs nothing: `scene.split_triangles` says how small a piece may be.)
Method   By material first, which adds no draw call. Then in an octree of cell_m times a power of two, on the fixed
         grid: a connected component no larger than a cell goes as a whole, of larger ones each triangle for itself, to
         the child that holds its middle. What is larger than a child stays in the inner node as an object of its own.
         Neighbouring children with too few triangles are joined. Pieces keep the frame and the matrix of the whole, so
         that their float32 vertices meet exactly. What several objects share is cut once, on a grid of its own, as its
         largest instance: the instances share the pieces as they shared the whole.
Cutting what was cut changes nothing.
After    Jeschke, Wimmer, Schumann, Purgathofer. Automatic Impostor Placement ... I3D 2005, section 6.4.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from farfield.scene import kernels
from farfield.scene.level import Level, measure, repack

_LARGE_CELLS = 2.0
_NAMED = 16  # warnings of single objects; of more one sentence tells


def split_level(level: Level, *, cell_m: float, min_triangles: int) -> None:
    """Split every object larger than two cells with at least `min_triangles`; level.warnings says which.

    Coordinates of `level` are absolute: the grid's origin is that of the scene.
    """
    side = (level.object_box[:, 1] - level.object_box[:, 0]).max(1)
    mesh_triangle = level.mesh_triangles()
    counts = np.diff(mesh_triangle)
    large = np.flatnonzero((side > _LARGE_CELLS * cell_m) & (counts[level.object_mesh] >= min_triangles))
    shared: dict[int, list[np.ndarray]] = {}  # of meshes that several objects use
    pieces: dict[int, list[np.ndarray]] = {}
    used = np.bincount(level.object_mesh, minlength=len(counts))
    for o in sorted(large.tolist(), key=lambda o: (-side[o], level.object_matrix[o, :, :3].ravel().tolist())):
        m = int(level.object_mesh[o])
        if used[m] == 1:
            found = _pieces(level, m, level.object_matrix[o], cell_m, min_triangles)
        else:
            if m not in shared:
                turned = np.concatenate([level.object_matrix[o, :, :3], np.zeros((3, 1))], axis=1)
                shared[m] = _pieces(level, m, turned, cell_m, min_triangles)
            found = shared[m]
        if len(found) > 1:
            pieces[o] = found
    if not pieces:
        return
    level.warnings += _warnings(level, pieces, side, cell_m)
    _rebuild(level, pieces)


def _rebuild(level: Level, pieces: dict[int, list[np.ndarray]]) -> None:
    """Put the pieces (triangle ids each) in the place of their objects; what shares a list of pieces shares meshes."""
    kept = [o for o in range(len(level.object_mesh)) if o not in pieces]
    meshes = np.unique(level.object_mesh[kept])
    number = np.full(len(level.mesh_primitive) - 1, -1)
    number[meshes] = np.arange(len(meshes))
    primitive_of = np.repeat(np.arange(len(level.primitive_material)), np.diff(level.primitive_triangle))
    parts: list[np.ndarray] = []  # triangles of each new primitive
    materials: list[int] = []
    mesh_primitive = [0]
    for m in meshes.tolist():
        for p in range(level.mesh_primitive[m], level.mesh_primitive[m + 1]):
            parts.append(np.arange(level.primitive_triangle[p], level.primitive_triangle[p + 1]))
            materials.append(int(level.primitive_material[p]))
        mesh_primitive.append(len(parts))
    object_mesh = number[level.object_mesh[kept]].tolist()
    matrices, names = [level.object_matrix[o] for o in kept], [level.object_name[o] for o in kept]
    looks = level.object_look[kept].tolist()
    first_mesh: dict[int, int] = {}  # of the pieces of a list
    for o in sorted(pieces):
        found = pieces[o]
        if id(found) not in first_mesh:
            first_mesh[id(found)] = len(mesh_primitive) - 1
            for triangles in found:
                parts.append(triangles)
                materials.append(int(level.primitive_material[primitive_of[triangles[0]]]))
                mesh_primitive.append(len(parts))
        for k in range(len(found)):
            object_mesh.append(first_mesh[id(found)] + k)
            matrices.append(level.object_matrix[o])
            names.append(f"{level.object_name[o]} [{k + 1}]")
            looks.append(level.object_look[o])
    repack(level, np.concatenate(parts), np.concatenate([[0], np.cumsum([len(p) for p in parts])]))
    level.primitive_material = np.array(materials, dtype=np.int32)
    level.mesh_primitive = np.array(mesh_primitive, dtype=np.int64)
    level.object_mesh = np.array(object_mesh, dtype=np.int32)
    level.object_matrix = np.array(matrices)
    level.object_name = names
    level.object_look = np.array(looks, dtype=np.uint8)
    measure(level)


def _warnings(level: Level, pieces: dict[int, list[np.ndarray]], side: np.ndarray, cell_m: float) -> list[str]:
    order = sorted(pieces, key=lambda o: (-side[o], level.object_name[o], len(pieces[o])))
    told = [
        f"{level.object_name[o]!r:.80} is {side[o]:.4g} m large, more than two cells of {cell_m:.4g} m; "
        f"it was split into {len(pieces[o])} objects."
        for o in order[:_NAMED]
    ]
    if len(pieces) > _NAMED:
        n = sum(len(pieces[o]) for o in order[_NAMED:])
        told.append(f"{len(pieces) - _NAMED} more objects larger than two cells were split into {n} objects.")
    return told


def _pieces(level: Level, m: int, matrix: np.ndarray, cell_m: float, min_triangles: int) -> list[np.ndarray]:
    """Return the triangles (ids in the level) of each piece of mesh m as the matrix places it, one material a piece."""
    first, last = (int(level.primitive_triangle[level.mesh_primitive[k]]) for k in (m, m + 1))
    primitive = np.repeat(np.arange(len(level.primitive_material)), np.diff(level.primitive_triangle))[first:last]
    material = level.primitive_material[primitive]
    start, stop = (int(level.primitive_vertex[level.mesh_primitive[k]]) for k in (m, m + 1))
    placed = np.empty((stop - start, 3))
    kernels.place(level.position[start:stop], np.ascontiguousarray(matrix), placed)
    index = level.index[first:last] - start
    found = []
    for k in np.unique(material).tolist():
        part = np.flatnonzero(material == k)
        if len(part) < 2 * min_triangles:
            found.append(first + part)
        else:
            found += [first + part[p] for p in _octree_pieces(placed, index[part], cell_m, min_triangles)]
    return found


def _octree_pieces(position: np.ndarray, index: np.ndarray, cell_m: float, min_triangles: int) -> list[np.ndarray]:
    corner = position[index]
    low, high = corner.min(1), corner.max(1)
    # Components no larger than a cell count as one: give all their triangles the component's box.
    component = _components(position, index)
    n = int(component.max()) + 1
    component_low, component_high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(component_low, component, low)
    np.maximum.at(component_high, component, high)
    whole = ((component_high - component_low).max(1) <= cell_m)[component]
    low = np.where(whole[:, None], component_low[component], low)
    high = np.where(whole[:, None], component_high[component], high)
    cell = np.floor((low * 0.5 + high * 0.5) / cell_m).astype(np.int64)
    size = (high - low).max(1)
    pieces: list[np.ndarray] = []

    def cut(members: np.ndarray) -> None:
        """Cut the triangles of a node at the finest node that holds them."""
        spread = int(np.bitwise_or.reduce(cell[members] ^ cell[members[0]], axis=0).max())
        negative = (cell[members] < 0).any(0) & (cell[members] >= 0).any(0)
        levels = 63 if negative.any() else spread.bit_length()  # the node is 2**levels cells wide
        if len(members) < 2 * min_triangles or levels == 0:
            pieces.append(members)
            return
        child = _half_width(cell, members, levels)
        stays = size[members] > child * cell_m
        if stays.any():
            pieces.append(members[stays])
        rest = members[~stays]
        if not len(rest):
            return
        octant = _octant(cell[rest], levels)
        groups: list[list[np.ndarray]] = [[]]
        for k in range(8):
            part = rest[octant == k]
            if len(part) >= min_triangles:
                cut(part)
            elif len(part):
                if sum(map(len, groups[-1])) >= min_triangles:
                    groups.append([])
                groups[-1].append(part)
        if len(groups) > 1 and sum(map(len, groups[-2] + groups[-1])) < 2 * min_triangles:
            groups[-2:] = [groups[-2] + groups[-1]]
        pieces.extend(np.sort(np.concatenate(group)) for group in groups if group)

    cut(np.arange(len(index)))
    return pieces


def _octant(cell: np.ndarray, levels: int) -> np.ndarray:
    """Which child of a node 2**levels cells wide; 63 levels: the halves below and above 0."""
    bit = (cell >= 0).astype(np.int64) if levels == 63 else (cell >> (levels - 1)) & 1
    return bit[:, 0] * 4 + bit[:, 1] * 2 + bit[:, 2]


def _half_width(cell: np.ndarray, members: np.ndarray, levels: int) -> float:
    """Cells a child is wide; of the root that straddles 0, the power of two that holds all its cells."""
    if levels < 63:
        return float(2 ** (levels - 1))
    reach = int(max(cell[members].max() + 1, -cell[members].min()))
    return float(2 ** (reach - 1).bit_length())


def _components(position: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(T,) component of each triangle; vertices at equal positions are one."""
    used, corner = np.unique(index, return_inverse=True)
    _, weld = np.unique(position[used] + 0.0, axis=0, return_inverse=True)
    corner = weld.reshape(-1)[corner].reshape(-1, 3)
    n = int(corner.max()) + 1
    a, b = corner[:, :2].reshape(-1), corner[:, 1:].reshape(-1)
    graph = coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return label[corner[:, 0]]
