"""A finished placement as the base of another: what it kept for that, beside its placement database.

Problem  A level changed a little. What of its old placement still holds should be neither chosen, baked nor packed again,
         and clients should not have to fetch it again.
Method   Every job leaves `base.ffc`: the digest of each object, the impostors with their view cells and measured figures,
         where each is shown, and all that is drawn of them. The pages are those of the placement database, and are taken
         over as files: under the same names, with the same bytes. A page of which nothing is used any more is left out.
         The manifest states the digest of `base.ffc`: what names a base names all that is read of it.
Errs     Towards larger pages: texels of impostors that went stay in the pages of those that are kept.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.columns import pack, unpack
from farfield.errors import BaseUnfit, ColumnsAltered
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.placement.base import Base
from farfield.placement.model import Placement
from farfield.placementdb import layout
from farfield.placementdb.faults import base_fault
from farfield.placementdb.read import Placement as Files
from farfield.placementdb.read import read_stated
from farfield.placementdb.table import LayerTable, take
from farfield.scene.identity import object_digests
from farfield.scene.model import Scene
from farfield.settings import Settings, parse_budget, to_mapping
from farfield.viewspace.model import ProblemViews

NAME, KIND = "base.ffc", "Base"
VERSION = 2  # raised with what an impostor is or costs: with the version of a step from the scene to the bake


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptLayers:
    """What is drawn of the impostors that a placement took from its base, in its order."""

    table: LayerTable  # pages numbered as in `pages`
    pages: Sequence[bytes]  # the files
    renderer: str


def base_file(
    scene: Scene, hierarchy: Hierarchy, cells: CellTree, views: ProblemViews, placement: Placement, table: LayerTable
) -> bytes:  # fmt: skip
    """Return the file `base.ffc` of a placement; `table` is what is drawn of all its impostors."""
    n = len(placement.cluster)
    of_entry = np.repeat(views.cell, np.diff(placement.serve_row)).astype(np.int64)
    pairs = np.unique(placement.serve.astype(np.int64) * cells.n_cells + of_entry)
    base = Base(
        object_digest=object_digests(scene), object_box=scene.object_box, origin_m=scene.origin_m, cell_box=cells.cell_box,
        start=hierarchy.start[placement.cluster], stop=hierarchy.stop[placement.cluster], kind=placement.kind,
        view_cell=placement.view_cell, bytes=placement.bytes, layers=placement.layers, cost=placement.cost,
        cell_row=np.searchsorted(pairs, np.arange(n + 1) * cells.n_cells), cell=(pairs % cells.n_cells).astype(np.int32),
    )  # fmt: skip
    columns = {f.name: getattr(base, f.name) for f in fields(Base)}
    columns |= {_TABLE + f.name: getattr(table, f.name) for f in fields(LayerTable)}
    return pack(KIND, layout.cast(columns, layout.BASE), {"version": VERSION})


_TABLE = "table_"


class BaseFiles:
    """An open base: the folder of a finished job."""

    def __init__(self, folder: Path) -> None:
        """Open `folder`, that of `farfield place --out`. Raises BaseUnfit for one of another version, and
        PlacementFileError where a file is missing or damaged."""
        self._files = Files.open(folder / "placement")
        self.manifest = self._files.manifest
        if self.manifest.get("base") is None:
            raise BaseUnfit(f"{folder} is of another version")
        kind, self.columns, meta = unpack(read_stated(folder, NAME, self.manifest["base"]), where=NAME)
        if kind != KIND or meta.get("version") != VERSION:
            raise BaseUnfit(f"{folder / NAME} is of another version")
        if fault := base_fault(self.columns, self.manifest):
            raise ColumnsAltered(NAME, fault)
        try:
            made = self.manifest["provenance"]
            self.settings, self.renderer = dict(made["settings"]), str(made["software"]["renderer"])
        except (KeyError, TypeError, ValueError) as error:
            raise ColumnsAltered(layout.MANIFEST, "it does not state how it was made") from error

    @property
    def sha256(self) -> str:
        """What names the base: the digest that its manifest states of itself."""
        return str(self.manifest["manifest_sha256"])

    def read(self) -> Base:
        """Return what the placement needs of it."""
        return Base(**{f.name: self.columns[f.name] for f in fields(Base)})

    def layers_of(self, impostors: np.ndarray) -> KeptLayers:
        """Return what is drawn of its impostors (K,), and the pages that they are on. Raises PlacementFileError for a damaged
        page."""
        table = LayerTable(**{f.name: self.columns[_TABLE + f.name] for f in fields(LayerTable)})
        table = take(table, impostors)
        used, page = np.unique(table.page, return_inverse=True)
        pages = [self._files.page_file(k) for k in used]
        return KeptLayers(
            table=replace(table, page=page.reshape(-1).astype(np.int32)), pages=pages, renderer=self.renderer
        )  # fmt: skip


def open_base(folder: Path, settings: Settings) -> BaseFiles:
    """Return the base in `folder`. Raises BaseUnfit if its impostors would not be those of these settings."""
    base = BaseFiles(folder)
    old, new = (_shaping(values) for values in (base.settings, to_mapping(settings)))
    for key in sorted(old.keys() | new.keys()):
        if old.get(key) != new.get(key):
            raise BaseUnfit(f"it was placed with {key} = {old.get(key)!r}, not {new.get(key)!r}")
    return base


FREE = (  # settings that may differ from the base's
    "budget", "seed", "proof", "visibility", "view_space.boxes", "placement.base", "placement.assignment", "placement.bound",
    "placement.hopeless", "placement.hopeless_slack", "placement.regions", "placement.reverse_delete",
    "placement.time_limit_s", "placement.density",
)  # fmt: skip


def _shaping(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the settings that shape what an impostor is and costs, by dotted key."""
    out: dict[str, Any] = {}
    for name, value in settings.items():
        key = prefix + name
        if key in FREE:
            continue
        out |= _shaping(value, key + ".") if isinstance(value, Mapping) else {key: value}
    if not prefix:
        out["the unit of budget"] = parse_budget(str(settings.get("budget"))).unit
    return out
