"""Names, types and shapes of the placement database: what writer and reader agree on (docs/formats/placementdb.md)."""

from collections.abc import Mapping

import numpy as np

from farfield.impostor.weight import PAGE_TEXELS as PAGE_TEXELS

FORMAT, VERSION = "farfield placement", 6
# Written: VERSION. Read: from OLDEST_VERSION on; below 6 index and chunks are not squeezed and the level is scene.glb only.
OLDEST_VERSION, DETAIL_VERSION = 3, 4
SUFFIX = {"webp": ".webp", "png": ".png", "ktx2": ".ktx2"}  # of a page, by its format
MANIFEST = "manifest.json"
INDEX_KIND, CHUNK_KIND = "PlacementIndex", "PlacementChunk"
GEOMETRY_INDEX_KIND, GEOMETRY_PAGE_KIND = "GeometryIndex", "GeometryPage"
NAME_DIGITS = 16  # hex digits of the SHA-256 in a file's name
DIGEST_KEY = b'"manifest_sha256":"'

ALIGN_TEXELS = 8  # 2 ** (levels - 1): no texel of the coarsest level lies over two tiles
LEVELS = ((0, 0, 1024), (0, 1024, 512), (512, 1024, 256), (768, 1024, 128))  # x, y, size in the page's image
PAGE_WIDTH, PAGE_HEIGHT = 1024, 1536
MAX_CORNERS = 8

# name -> (dtype, sizes); a letter is a size that must agree wherever it stands, "K+1" one more than it, "K?" it or 0
Columns = Mapping[str, tuple[str, tuple[str | int, ...]]]

INDEX: Columns = {
    "node_axis": ("|i1", ("K",)), "node_plane": ("<f8", ("K",)), "node_low": ("<i4", ("K",)),
    "node_high": ("<i4", ("K",)), "node_parent": ("<i4", ("K",)), "node_box": ("<f8", ("K", 2, 3)),
    "node_start": ("<i4", ("K",)), "node_stop": ("<i4", ("K",)), "cell_node": ("<i4", ("L",)),
    "cell_cost": ("<i8", ("L",)), "view_box": ("<f8", ("B", 2, 3)),
    "object_box": ("<f8", ("N", 2, 3)), "object_cost": ("<i8", ("N",)), "object_calls": ("<i4", ("N",)),
    "object_triangles": ("<i4", ("N",)),
    "cluster_start": ("<i4", ("C",)), "cluster_stop": ("<i4", ("C",)), "cluster_left": ("<i4", ("C",)),
    "cluster_right": ("<i4", ("C",)), "cluster_parent": ("<i4", ("C",)), "cluster_box": ("<f8", ("C", 2, 3)),
    "impostor_cluster": ("<i4", ("I",)), "impostor_kind": ("|u1", ("I",)), "impostor_view_cell": ("<f8", ("I", 9)),
    "impostor_bytes": ("<i8", ("I",)), "impostor_cost": ("<i8", ("I",)), "impostor_triangles": ("<i4", ("I",)),
    "impostor_layers": ("<i4", ("I",)), "impostor_chunk": ("<i4", ("I",)),
}  # fmt: skip

DETAIL: Columns = {  # of the index too, where objects have levels of detail
    "level_row": ("<i4", ("N+1",)), "level_from": ("<f8", ("D",)), "level_cost": ("<i8", ("D",)),
    "level_triangles": ("<i4", ("D",)),
}  # fmt: skip

CHUNK: Columns = {
    "cell_view": ("<i4", ("n+1",)), "cell_visible": ("<i4", ("n?",)), "visible_row": ("<i4", ("Z",)),
    "visible_object": ("<i4", ("E",)),
    "view_interval": ("<i4", ("V",)), "view_cost": ("<i8", ("V",)), "view_geometry_cost": ("<i8", ("V",)),
    "view_hopeless": ("|u1", ("V",)), "view_list": ("<i4", ("V",)),
    "list_row": ("<i4", ("S+1",)), "list_impostor": ("<i4", ("T",)),
    "impostor_id": ("<i4", ("M",)), "impostor_eye": ("<f8", ("M", 3)), "impostor_right": ("<f8", ("M", 3)),
    "impostor_up": ("<f8", ("M", 3)), "impostor_layer": ("<i4", ("M+1",)),
    "layer_number": ("<u2", ("R",)), "layer_plane": ("<f8", ("R",)), "layer_inverse_near": ("<f8", ("R",)),
    "layer_inverse_far": ("<f8", ("R",)), "layer_page": ("<i4", ("R",)), "layer_rect": ("<u2", ("R", 4)),
    "layer_corner": ("<i4", ("R+1",)),
    "corner_position": ("<f4", ("Q", 3)), "corner_uv": ("<f4", ("Q", 2)),
}  # fmt: skip

GEOMETRY_INDEX: Columns = {
    "object_mesh": ("<i4", ("N",)), "object_matrix": ("<f8", ("N", 3, 4)), "object_color": ("|u1", ("N", 3)),
    "mesh_primitive": ("<i4", ("M+1",)), "primitive_material": ("<i4", ("P",)),
    "mesh_model": ("<i4", ("M+1",)), "model_page": ("<i4", ("Q",)), "model_slot": ("<i4", ("Q",)),
    "material_base_color": ("<f4", ("K", 4)), "material_emissive": ("<f4", ("K", 3)), "material_alpha": ("|u1", ("K",)),
    "material_cutoff": ("<f4", ("K",)), "material_unlit": ("|u1", ("K",)), "material_two_sided": ("|u1", ("K",)),
    "material_texture": ("<i4", ("K",)), "material_glow": ("<i4", ("K",)), "material_glow_apart": ("|u1", ("K",)),
    "texture_file": ("<i4", ("X",)), "texture_wrap": ("<i4", ("X", 2)), "texture_linear": ("|u1", ("X",)),
    "texture_smooth": ("|u1", ("X",)), "texture_color": ("|u1", ("X", 3)),
}  # fmt: skip

GEOMETRY_PAGE: Columns = {
    "model_part": ("<i4", ("m+1",)), "part_triangle": ("<i4", ("R+1",)), "position": ("<f4", ("V", 3)),
    "normal": ("<f4", ("V", 3)), "uv": ("<f4", ("V?", 2)), "glow_uv": ("<f4", ("V?", 2)), "color": ("<f4", ("V?", 4)),
    "index": ("<u4", ("T", 3)),
}  # fmt: skip

BASE: Columns = {  # of base.ffc: the fields of farfield.placement.base.Base, and those of the layer table as table_...
    "object_digest": ("|u1", ("N", 16)), "object_box": ("<f8", ("N", 2, 3)), "origin_m": ("<f8", (3,)),
    "cell_box": ("<f8", ("L", 2, 3)), "start": ("<i4", ("I",)), "stop": ("<i4", ("I",)), "kind": ("|u1", ("I",)),
    "view_cell": ("<f8", ("I", 9)), "bytes": ("<i8", ("I",)), "layers": ("<i4", ("I",)), "cost": ("<i8", ("I",)),
    "cell_row": ("<i8", ("I+1",)), "cell": ("<i4", ("S",)),
    "table_eye": ("<f8", ("I", 3)), "table_right": ("<f8", ("I", 3)), "table_up": ("<f8", ("I", 3)),
    "table_layer_row": ("<i8", ("I+1",)), "table_number": ("<u2", ("R",)), "table_plane": ("<f8", ("R",)),
    "table_inverse_near": ("<f8", ("R",)), "table_inverse_far": ("<f8", ("R",)), "table_page": ("<i4", ("R",)),
    "table_rect": ("<u2", ("R", 4)), "table_corner_row": ("<i8", ("R+1",)), "table_position": ("<f4", ("Q", 3)),
    "table_uv": ("<f4", ("Q", 2)),
}  # fmt: skip


def cast(columns: Mapping[str, np.ndarray], table: Columns) -> dict[str, np.ndarray]:
    """Return the columns in the types of `table`; asserts that nothing is missing, extra or loses an integer."""
    assert set(columns) == set(table), sorted(set(columns) ^ set(table))
    out = {}
    for name, (dtype, _) in table.items():
        array = np.asarray(columns[name])
        kept = array.astype(np.dtype(dtype))
        assert array.dtype.kind == "f" or np.array_equal(kept, array), f"{name} does not fit into {dtype}"
        out[name] = kept
    assert misfit(out, table) is None, misfit(out, table)
    return out


def misfit(columns: Mapping[str, np.ndarray], table: Columns) -> str | None:
    """Return what is wrong with the types and shapes of the columns, or None. Columns not in `table` are ignored."""
    sizes: dict[str, int] = {}
    for name, (dtype, shape) in table.items():
        array = columns.get(name)
        if array is None:
            return f"column {name} is missing"
        if array.dtype.str != dtype or array.ndim != len(shape):
            return f"column {name} has the wrong type"
        for found, wanted in zip(array.shape, shape, strict=True):
            if isinstance(wanted, int):
                if found != wanted:
                    return f"column {name} has the wrong shape"
                continue
            if wanted.endswith("?") and found == 0:
                continue
            size = found - 1 if wanted.endswith("+1") else found
            if size < 0 or sizes.setdefault(wanted.rstrip("+1?"), size) != size:
                return f"column {name} has the wrong length"
    return None
