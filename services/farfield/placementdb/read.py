"""Read a placement database: what to draw at a position and direction. The twin of webviewer/src/placementdb.

    p = Placement.open("out/placement")
    v = p.lookup(position, direction)          # scene metres
    v.objects, v.impostors, v.cost_bound       # what to draw (before frustum culling), and what that costs at most
    p.impostors[i].layers                      # polygons with texture coordinates

Method   docs/formats/placementdb.md section 6, literally. Manifest and index are verified on opening, chunks and pages
         when first used; `check` verifies all. numpy only: the API image has neither numba nor OpenGL.
"""

import bisect
import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from farfield.columns import unpack
from farfield.errors import (
    ColumnsAltered,
    ColumnsTooNew,
    ColumnsTruncated,
    DirectionInvalid,
    NotColumns,
    OutsideViewSpace,
    PlacementFileMissing,
)
from farfield.geometry.cells import CellTree, find_cell
from farfield.placementdb import layout
from farfield.placementdb.faults import (
    chunk_fault,
    geometry_fault,
    geometry_page_fault,
    index_fault,
    manifest_fault,
)
from farfield.placementdb.squeeze import expand

_FILE = re.compile(r"(index-|chunks/|pages/|geometry/|textures/)[0-9a-f]{16}\.(ff[cz]|webp|png|jpg|ktx2)")
_DIGEST = re.compile(re.escape(layout.DIGEST_KEY) + rb"([0-9a-f]{64})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lookup:
    """What to draw at one position and direction."""

    cell: int
    interval: int
    problem_view: int | None
    hopeless: bool
    objects: np.ndarray  # (n,) i64  ids to draw as geometry where their box meets the view frustum, ascending
    levels: np.ndarray  # (n,) i64  at which level to draw each of them: 0 the object itself
    impostors: np.ndarray  # (m,) i64  ids, ascending
    cost_bound: int  # of the whole frame, per_frame included, in the budget's unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """A convex polygon of texels; a layer too large for a page is several of them with one `number`."""

    number: int
    plane: float  # distances from the eye, metres; far may be inf
    near: float
    far: float
    page: int
    rect: tuple[int, int, int, int]  # x, y, width, height of its texels in the page, level 0
    corners: np.ndarray  # (3..8, 3) f64  scene metres, counter-clockwise seen from the eye
    position: np.ndarray  # (3..8, 3) f32  relative to the eye, as stored
    uv: np.ndarray  # (3..8, 2) f32  texels of level 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Impostor:
    """What replaces the objects of one cluster."""

    id: int
    cluster: int
    objects: np.ndarray  # (n,) i64  ids it replaces
    bytes: int
    cost: int  # bound from anywhere in its view cell
    triangles: int
    kind: str  # "shaft" or "box"
    view_cell: np.ndarray  # (9,) f64  relative to origin_m, see the format
    eye: np.ndarray  # (3,) f64  scene metres
    layers: tuple[Layer, ...]  # near to far; none if it is shown nowhere


class Placement:
    """An open placement database. Safe to share between threads: what it remembers is only what it has verified."""

    def __init__(self, folder: Path, manifest: dict[str, Any], index: dict[str, np.ndarray]) -> None:
        self.folder, self.manifest, self.index = folder, manifest, index
        self.origin_m = np.array(manifest["origin_m"], dtype=np.float64)
        self.impostors = Impostors(self)
        self._boxes_m = np.array(manifest["view_space"], dtype=np.float64).reshape(-1, 2, 3)
        self._edges = [float(e) for e in manifest["interval_edges"]]
        self._first_cells = [entry["cells"][0] for entry in manifest["chunks"]]
        self._chunks: dict[int, dict[str, np.ndarray]] = {}
        self._tree = CellTree(
            axis=index["node_axis"], plane=index["node_plane"], low=index["node_low"], high=index["node_high"],
            parent=index["node_parent"], box=index["node_box"], start=index["node_start"], stop=index["node_stop"],
            leaf=index["cell_node"],
        )  # fmt: skip

    @classmethod
    def open(cls, folder: str | Path) -> "Placement":
        """Return the placement in `folder` (`DIR/placement`, or the DIR that holds it).

        Raises PlacementFileMissing, ColumnsTruncated, ColumnsTooNew, ColumnsAltered, NotColumns; each names the file.
        """
        folder = Path(folder)
        if not (folder / layout.MANIFEST).is_file() and (folder / "placement" / layout.MANIFEST).is_file():
            folder = folder / "placement"
        manifest = _read_manifest(folder)
        kind, index, _ = _columns(folder, manifest["index"])
        fault = "it is not an index" if kind != layout.INDEX_KIND else index_fault(index, manifest)
        if fault:
            raise ColumnsAltered(manifest["index"]["file"], fault)
        return cls(folder, manifest, index)

    def lookup(self, position: Any, direction: Any) -> Lookup:
        """Return what to draw at `position` (3, scene metres) looking along `direction` (3, any length but 0).

        Raises OutsideViewSpace and DirectionInvalid, and what `open` raises where a chunk is damaged.
        """
        cell, interval = self.find_cell(position), self.find_interval(direction)
        none = np.zeros(0, dtype=np.int64)
        view, hopeless, impostors = None, False, none
        seen, cost = self.seen_from(cell), int(self.manifest["worst_nonproblem"])
        k = self.chunk_of(cell)
        if k is not None:
            chunk, local = self.chunk(k), cell - self._first_cells[k]
            a, b = chunk["cell_view"][local : local + 2]
            v = a + int(np.searchsorted(chunk["view_interval"][a:b], interval))
            if v < b and chunk["view_interval"][v] == interval:
                first, stop = chunk["list_row"][chunk["view_list"][v] :][:2]
                impostors = chunk["impostor_id"][chunk["list_impostor"][first:stop]].astype(np.int64)
                view, hopeless = self.manifest["chunks"][k]["views"][0] + int(v), bool(chunk["view_hopeless"][v])
                cost = int(chunk["view_cost"][v])
        for cluster in self.index["impostor_cluster"][impostors]:
            seen[self.index["cluster_start"][cluster] : self.index["cluster_stop"][cluster]] = False
        objects = np.flatnonzero(seen)
        return Lookup(
            cell=cell, interval=interval, problem_view=view, hopeless=hopeless, objects=objects,
            levels=self.levels_in(cell)[objects], impostors=impostors,
            cost_bound=cost + int(self.manifest["cost_model"]["per_frame"]),
        )  # fmt: skip

    def chunk_of(self, cell: int) -> int | None:
        """Return the chunk that holds the cell's views and visible objects; None: it has nothing to say of it."""
        k = bisect.bisect_right(self._first_cells, cell) - 1
        return k if k >= 0 and cell < self.manifest["chunks"][k]["cells"][1] else None

    def seen_from(self, cell: int) -> np.ndarray:
        """Return (N,) b1: the objects that may be seen from somewhere in the cell."""
        k = self.chunk_of(cell)
        chunk = self.chunk(k) if k is not None else {}
        if k is None or not len(chunk["cell_visible"]):
            return np.ones(len(self.index["object_box"]), dtype=bool)
        seen = np.zeros(len(self.index["object_box"]), dtype=bool)
        a, b = chunk["visible_row"][chunk["cell_visible"][cell - self._first_cells[k]] :][:2]
        seen[chunk["visible_object"][a:b]] = True
        return seen

    def levels_in(self, cell: int) -> np.ndarray:
        """Return (N,) i64: the level at which each object is drawn from anywhere in the cell."""
        index = self.index
        out = np.zeros(len(index["object_box"]), dtype=np.int64)
        if "level_row" not in index:
            return out
        low, high = index["node_box"][index["cell_node"][cell]]
        gap = np.maximum(np.maximum(index["object_box"][:, 0] - high, low - index["object_box"][:, 1]), 0.0)
        distance = np.sqrt(gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1] + gap[:, 2] * gap[:, 2])
        row = index["level_row"]
        of = np.repeat(np.arange(len(out)), np.diff(row))
        near_enough = index["level_from"] <= distance[of]
        level = np.arange(len(of)) - row[of] + 1
        np.maximum.at(out, of[near_enough], level[near_enough])
        return out

    def find_cell(self, position: Any) -> int:
        """Return the leaf cell of a position (3, scene metres). Raises OutsideViewSpace."""
        p = np.asarray(position, dtype=np.float64).reshape(3)
        boxes = self.index["view_box"]
        q = p - self.origin_m
        cell = find_cell(self._tree, boxes, q)
        if cell < 0:
            held = np.flatnonzero(((self._boxes_m[:, 0] <= p) & (p <= self._boxes_m[:, 1])).all(1))
            if not len(held):
                raise OutsideViewSpace(f"position {tuple(p.tolist())} is outside the view space")
            cell = find_cell(self._tree, boxes, np.clip(q, *boxes[held[0]]))
        return cell

    def find_interval(self, direction: Any) -> int:
        """Return the direction interval of a direction (3). Raises DirectionInvalid."""
        d = [float(x) for x in np.asarray(direction, dtype=np.float64).reshape(3)]
        size = [abs(x) for x in d]
        m = size.index(max(size))
        if not 0 < max(size) < float("inf") or any(x != x for x in d):
            raise DirectionInvalid(f"direction {tuple(d)} has no direction")
        n = len(self._edges) - 1
        i, j = (
            bisect.bisect_right(self._edges, d[(m + k) % 3] / size[m], 1, n) - 1 for k in (1, 2)
        )  # inner edges only: the last interval holds its upper end
        return ((2 * m + (d[m] < 0)) * n + j) * n + i

    def chunk(self, k: int) -> dict[str, np.ndarray]:
        """Return the columns of chunk `k`, verified."""
        if k not in self._chunks:
            entry = self.manifest["chunks"][k]
            kind, columns, meta = _columns(self.folder, entry)
            fault = (
                "it is not a chunk" if kind != layout.CHUNK_KIND else chunk_fault(columns, meta, entry, self.manifest)
            )
            if fault:
                raise ColumnsAltered(entry["file"], fault)
            self._chunks[k] = columns
        return self._chunks[k]

    def page(self, k: int) -> np.ndarray:
        """Return the (1536, 1024, 4) u1 image of page `k` with all its levels, verified."""
        from farfield.placementdb.pages import NotAPage, decode

        try:
            return decode(self.page_file(k), self.manifest["page"].get("format", "webp"))
        except NotAPage as error:
            raise ColumnsAltered(self.manifest["pages"][k]["file"], f"it is {error}") from error

    def page_file(self, k: int) -> bytes:
        """Return the content of the file of page `k`, verified."""
        return _read(self.folder, self.manifest["pages"][k])

    def check(self) -> int:
        """Verify every file and return how many there are. Raises as `open` does."""
        for k in range(len(self.manifest["chunks"])):
            self.chunk(k)
        for entry in self.manifest["pages"]:
            _read(self.folder, entry)
        files = 2 + len(self.manifest["chunks"]) + len(self.manifest["pages"])
        if self.manifest.get("geometry") is None:
            return files
        geometry = self.geometry()
        for k in range(len(geometry["pages"])):
            self.geometry_page(k)
        for entry in geometry["textures"]:
            _read(self.folder, entry)
        return files + 1 + len(geometry["pages"]) + len(geometry["textures"])

    def geometry(self) -> dict[str, Any]:
        """Return the manifest's `geometry` with "columns", those of its index, verified. Only where there is one."""
        entry = self.manifest["geometry"]
        kind, columns, _ = _columns(self.folder, entry["index"])
        wrong = "it is not an index of geometry" if kind != layout.GEOMETRY_INDEX_KIND else None
        if fault := wrong or geometry_fault(columns, self.manifest, self.index):
            raise ColumnsAltered(entry["index"]["file"], fault)
        return {**entry, "columns": columns}

    def geometry_page(self, k: int) -> dict[str, np.ndarray]:
        """Return the columns of page `k` of the geometry, verified."""
        entry = self.manifest["geometry"]["pages"][k]
        kind, columns, meta = _columns(self.folder, entry)
        wrong = (
            f"it is not page {k} of the geometry"
            if kind != layout.GEOMETRY_PAGE_KIND or meta.get("page") != k
            else None
        )
        if fault := wrong or geometry_page_fault(columns):
            raise ColumnsAltered(entry["file"], fault)
        return columns


class Impostors(Sequence[Impostor]):
    """The impostors of a placement, by id."""

    def __init__(self, placement: Placement) -> None:
        self._of = placement

    def __len__(self) -> int:
        return len(self._of.index["impostor_cluster"])

    def __iter__(self) -> Iterator[Impostor]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [self[k] for k in range(*i.indices(len(self)))]
        i = range(len(self))[int(i)]
        index, chunk = self._of.index, int(self._of.index["impostor_chunk"][i])
        cluster = int(index["impostor_cluster"][i])
        eye = np.full(3, np.nan)
        layers: tuple[Layer, ...] = ()
        if chunk >= 0:
            columns = self._of.chunk(chunk)
            m = int(np.searchsorted(columns["impostor_id"], i))
            eye = columns["impostor_eye"][m] + self._of.origin_m
            layers = tuple(_layer(columns, r, eye) for r in range(*columns["impostor_layer"][m : m + 2]))
        return Impostor(
            id=i, cluster=cluster, objects=np.arange(index["cluster_start"][cluster], index["cluster_stop"][cluster]),
            bytes=int(index["impostor_bytes"][i]), cost=int(index["impostor_cost"][i]),
            triangles=int(index["impostor_triangles"][i]), kind=("shaft", "box")[int(index["impostor_kind"][i])],
            view_cell=index["impostor_view_cell"][i], eye=eye, layers=layers,
        )  # fmt: skip


def _layer(columns: dict[str, np.ndarray], r: int, eye: np.ndarray) -> Layer:
    a, b = columns["layer_corner"][r : r + 2]
    near, far = float(columns["layer_inverse_near"][r]), float(columns["layer_inverse_far"][r])
    return Layer(
        number=int(columns["layer_number"][r]), plane=float(columns["layer_plane"][r]), near=1 / near,
        far=1 / far if far else float("inf"), page=int(columns["layer_page"][r]),
        rect=tuple(columns["layer_rect"][r].tolist()), position=columns["corner_position"][a:b],
        corners=eye + columns["corner_position"][a:b].astype(np.float64), uv=columns["corner_uv"][a:b],
    )  # fmt: skip


def _columns(folder: Path, entry: dict[str, Any]) -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
    """Return (kind, columns, meta) of a listed file; squeezed ones state how long they are when inflated."""
    content, name = _read(folder, entry), entry["file"]
    return expand(content, entry["expanded"], where=name) if name.endswith(".ffz") else unpack(content, where=name)


def _read(folder: Path, entry: dict[str, Any]) -> bytes:
    """Return the content of a listed file, verified."""
    if not _FILE.fullmatch(entry["file"]):
        raise ColumnsAltered(layout.MANIFEST, f"it names the file {entry['file']!r}")
    return read_stated(folder, entry["file"], entry)


def read_stated(folder: Path, name: str, entry: dict[str, Any]) -> bytes:
    """Return the content of a file if it has the size and digest that the manifest's entry states."""
    try:
        content = (folder / name).read_bytes()
    except OSError as error:
        raise PlacementFileMissing(str(folder / name)) from error
    if len(content) < entry["bytes"]:
        raise ColumnsTruncated(name, len(content), entry["bytes"])
    if len(content) > entry["bytes"] or hashlib.sha256(content).hexdigest() != entry["sha256"]:
        raise ColumnsAltered(name, "its size or SHA-256 is not what the manifest states")
    return content


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / layout.MANIFEST
    try:
        text = path.read_bytes()
    except OSError as error:
        raise PlacementFileMissing(str(path)) from error
    try:
        manifest = json.loads(text)
    except (ValueError, RecursionError) as error:
        if text[:1] == b"{" and not text.endswith(b"}\n"):
            raise ColumnsTruncated(layout.MANIFEST, len(text), len(text) + 1) from error
        raise ColumnsAltered(layout.MANIFEST, "it is not JSON") from error
    if not isinstance(manifest, dict) or manifest.get("format") != layout.FORMAT:
        raise NotColumns(layout.MANIFEST)
    if isinstance(v := manifest.get("version"), int) and not layout.OLDEST_VERSION <= v <= layout.VERSION:
        raise ColumnsTooNew(layout.MANIFEST, v, layout.VERSION)
    stated = _DIGEST.findall(text)
    zeroed = _DIGEST.sub(layout.DIGEST_KEY + b"0" * 64, text)
    if len(stated) != 1 or hashlib.sha256(zeroed).hexdigest() != stated[0].decode():
        raise ColumnsAltered(layout.MANIFEST, "its manifest_sha256 is not that of its content")
    fault = manifest_fault(manifest)
    if fault:
        raise ColumnsAltered(layout.MANIFEST, fault)
    return manifest
