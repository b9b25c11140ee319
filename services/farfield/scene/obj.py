"""Wavefront OBJ -> RawScene: one object per `o` and `g` name, one primitive per material in it.

Own reader, because trimesh takes one `mtllib`, keeps faces whose indices are out of range, and decodes textures of any
size. Indices from the end, mixed and missing attributes, concave faces and vertex colours (`v x y z r g b`, sRGB) are
read; points, lines, curves and free-form surfaces are not. Its materials: `mtl.py`.
"""

import posixpath
from array import array

import numpy as np

from farfield.errors import SceneFileMissing, SceneIndexOutOfRange, SceneNotFinite, SceneUnreadable
from farfield.scene.files import SceneFiles, relative_name
from farfield.scene.limits import Limits, need
from farfield.scene.mtl import MtlReader
from farfield.scene.polygons import triangulate
from farfield.scene.raw import RawNode, RawPrimitive, RawScene, linear_from_srgb

_CURVES = {"curv", "curv2", "surf", "cstype"}


def read_obj(data: bytes, files: SceneFiles, limits: Limits) -> RawScene:
    """Return the level of an OBJ file; `files` reads its MTL files and their textures. Raises SceneError."""
    return _Reader(files, limits).read(data.decode("utf-8", "replace"))


class _Reader:
    def __init__(self, files: SceneFiles, limits: Limits) -> None:
        self.files, self.limits = files, limits
        self.scene = RawScene(default_double_sided=True)
        self.mtl = MtlReader(files, self.scene, limits)
        # one row a vertex, as text until all are there; the faces as flat integer columns
        self.v: list[str] = []
        self.vt: list[str] = []
        self.vn: list[str] = []
        self.corner = tuple(array("q") for _ in range(3))  # position, texture coordinate, normal; -1 none
        self.size, self.face_part = array("q"), array("q")
        self.parts: dict[tuple[str, str], int] = {}  # (object name, material name)
        self.libraries: set[str] = set()

    def read(self, text: str) -> RawScene:
        folder = posixpath.dirname(self.files.name)
        self.group, self.object, self.material = "", "", ""
        part = -1
        for number, line in enumerate(text.replace("\\\n", " ").replace("\\\r\n", " ").splitlines(), 1):
            fields = line.split(None, 1)
            if not fields:
                continue
            key, rest = fields[0], fields[1].strip() if len(fields) > 1 else ""
            if key == "v":
                self.v.append(rest)
            elif key == "vt":
                self.vt.append(rest)
            elif key == "vn":
                self.vn.append(rest)
            elif key in ("f", "fo"):
                if part < 0:
                    part = self.parts.setdefault((self._name(), self.material), len(self.parts))
                self._face(rest.partition("#")[0], number, part)
            elif key == "o":
                self.object, self.group, part = rest, "", -1
            elif key == "g":
                self.group, part = rest, -1
            elif key == "usemtl":
                self.material, part = rest, -1
            elif key == "mtllib" and rest not in self.libraries:
                self.libraries.add(rest)
                self._mtllib(rest, folder)
            elif key in _CURVES:
                self._warn("Curves and free-form surfaces are left out.")
        return self._finish()

    def _warn(self, text: str) -> None:
        self.scene.warn(text)

    def _name(self) -> str:
        return "/".join(n for n in (self.object, self.group) if n) or posixpath.basename(self.files.name)

    def _mtllib(self, rest: str, folder: str) -> None:
        """A name may hold spaces, and a line several names: the whole line first."""
        for names in ([rest], rest.split()):
            missing = []
            for name in names:
                try:
                    self.mtl.read(relative_name(name, base=folder))
                except SceneFileMissing:
                    missing.append(name)
            if not missing:
                return
        self._warn(f"The material file {missing[0][:120]!r} is missing; its materials are plain white.")

    def _face(self, rest: str, number: int, part: int) -> None:
        counts = (len(self.v), len(self.vt), len(self.vn))
        fields = rest.split()
        for field in fields:
            texts = field.split("/")
            for k in range(3):
                value = -1
                if k < len(texts) and texts[k]:
                    try:
                        given = int(texts[k])
                    except ValueError as error:
                        raise SceneUnreadable(f"Line {number}: {field[:80]!r} is no face corner.") from error
                    value = given - 1 if given > 0 else counts[k] + given
                    if k == 0 and (given == 0 or value < 0):
                        raise SceneIndexOutOfRange(f"Line {number} refers to vertex {given} of {counts[0]}.")
                    if given == 0 or value < 0 or value > 2**40:
                        value = 2**40  # no such attribute: found out when all are known
                elif k == 0:
                    raise SceneUnreadable(f"Line {number}: {field[:80]!r} is no face corner.")
                self.corner[k].append(value)
        self.size.append(len(fields))
        self.face_part.append(part)

    def _rows(self, texts: list[str], widths: tuple[int, ...], what: str) -> np.ndarray:
        """Return (n, width) f64 of rows of text, padded by NaN to the largest width of `widths` that occurs."""
        if not texts:
            return np.zeros((0, widths[0]))
        try:
            width = len(texts[0].split())
            if width in widths:
                flat = np.array(" ".join(texts).split(), dtype=np.float64)
                if flat.size == width * len(texts) and all(len(t.split()) == width for t in texts):
                    return flat.reshape(-1, width)
            rows = np.full((len(texts), widths[-1]), np.nan)
            for i, text in enumerate(texts):
                fields = text.partition("#")[0].split()[: widths[-1]]
                if len(fields) < widths[0]:
                    raise SceneUnreadable(f"{what} {i + 1} has {len(fields)} numbers.")
                rows[i, : len(fields)] = [float(f) for f in fields]
            return rows
        except ValueError as error:
            raise SceneUnreadable(f"A {what} is not numbers: {error}.") from error

    def _finish(self) -> RawScene:
        need(len(self.v), self.limits.vertices, "vertices")
        v = self._rows(self.v, (3, 4, 6), "vertex")
        vt = self._rows(self.vt, (2, 3), "texture coordinate") if self.vt else np.zeros((0, 2))
        vn = self._rows(self.vn, (3,), "normal")
        corner = [np.frombuffer(c, dtype=np.int64) if len(c) else np.zeros(0, np.int64) for c in self.corner]
        size = np.array(self.size, dtype=np.int64)
        need(int((size - 2).clip(0).sum()), self.limits.triangles, "triangles")
        if len(corner[0]) and corner[0].max() >= len(v):
            raise SceneIndexOutOfRange(f"A face refers to vertex {corner[0].max() + 1} of {len(v)}.")
        if not np.isfinite(v[np.unique(corner[0]), :3]).all():
            raise SceneNotFinite("A vertex position is not finite.")
        position = np.ascontiguousarray(v[:, :3])
        color = linear_from_srgb(v[:, 3:6]).astype(np.float32) if v.shape[1] == 6 else None
        triangle, face = triangulate(position, corner[0], size)
        part = np.array(self.face_part, dtype=np.int64)[face]

        def attribute(k: int, table: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, bool]:
            """Return the attribute's index at corners `rows`, 0 where there is none, and whether all have one."""
            at = corner[k][rows]
            known = (at >= 0) & (at < len(table))
            if ((at >= 0) & ~known).any():
                self._warn("Some faces refer to normals or texture coordinates that are not there; they go without.")
            return np.where(known, at, 0), bool(known.all())

        by_part = np.argsort(part, kind="stable")
        ends = np.searchsorted(part[by_part], np.arange(len(self.parts) + 1))
        meshes: dict[str, int] = {}
        for (name, material), p in self.parts.items():
            rows = triangle[by_part[ends[p] : ends[p + 1]]]
            if not len(rows):
                continue
            uv_at, has_uv = attribute(1, vt, rows)
            normal_at, has_normal = attribute(2, vn, rows)
            key = np.stack([corner[0][rows], uv_at * has_uv, normal_at * has_normal], -1).reshape(-1, 3)
            order = np.lexsort((key[:, 2], key[:, 1], key[:, 0]))
            new = np.concatenate([[True], (np.diff(key[order], axis=0) != 0).any(1)])
            index = np.empty(len(key), dtype=np.int64)
            index[order] = np.cumsum(new) - 1
            at = key[order][new]
            self.mtl.use(material)
            number, texture_transform = self.mtl.materials.get(material, (-1, None))
            uv = None
            if has_uv:
                u, t = vt[at[:, 1], 0], vt[at[:, 1], 1]
                if texture_transform is not None:
                    (su, sv), (ou, ov) = texture_transform
                    u, t = u * su + ou, t * sv + ov
                uv = np.stack([u, 1.0 - t], 1).astype(np.float32)
            rgba = None
            if color is not None:
                rgba = np.ones((len(at), 4), dtype=np.float32)
                rgba[:, :3] = np.nan_to_num(color[at[:, 0]], nan=1.0)
            if name not in meshes:
                meshes[name] = len(self.scene.meshes)
                self.scene.meshes.append([])
                self.scene.nodes.append(RawNode(name, meshes[name], np.eye(4)))
            self.scene.meshes[meshes[name]].append(
                RawPrimitive(
                    position=position[at[:, 0]], index=index.reshape(-1, 3), material=number, uv=uv, color=rgba,
                    normal=vn[at[:, 2]].astype(np.float32) if has_normal else None,
                )
            )  # fmt: skip
        return self.scene
