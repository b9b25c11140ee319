"""Write the impostors of a placement as glTF 2.0: textured polygons, unlit, alpha masked; .glb, or .gltf with files.

Problem  An engine team wants the impostors in its own tools, exactly where and as they are, without our reader.
Method   A node an impostor, its translation the impostor's eye, so that vertices keep the float32 values of the
         database; a mesh with a primitive a page; a material a page (KHR_materials_unlit, MASK at 0.5, nearest
         filter: neighbours in an atlas have no gutter). Where a node is shown stands in its extras, as ids of
         cells, intervals and problem views; what it replaces as ids of objects, which nodes of scene.glb carry too. A scene
         for all of them, and one for each view cell.
         Chunks and pages are read one at a time, geometry and pictures go through a temporary file: memory holds one
         chunk, one page and the JSON text, however large the placement.
Errs     Depth in a texel is lost: a layer stands on its plane. What it hides or is hidden by within its slab can differ
         from the viewer's picture.
"""

import json
import shutil
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

import numpy as np

from farfield.errors import ExportTooLarge
from farfield.export.pages import masked
from farfield.export.select import Selection, fresh, runs_of
from farfield.placementdb.layout import SUFFIX
from farfield.placementdb.pages import encode
from farfield.placementdb.read import Impostor, Placement

IMAGES = {"png": ("png",), "webp": ("webp",), "webp+png": ("png", "webp")}
NEAREST, CLAMP, FLOAT, USHORT, UINT, VERTICES, INDICES = 9728, 33071, 5126, 5123, 5125, 34962, 34963
MOST_GLB_BYTES = 2**32 - 1

Rects = dict[int, list[tuple[int, int, int, int]]]  # page -> what is read of it, in the order of the materials


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """What was written."""

    files: list[Path]
    impostors: int
    triangles: int
    pages: int
    bytes: int  # of all files


@dataclass(frozen=True, slots=True)
class _Streams:
    position: IO[bytes]
    uv: IO[bytes]
    index: IO[bytes]


def export_gltf(placement: Placement, selection: Selection, out: Path, *, images: str = "png") -> Exported:
    """Write the selected impostors to `out` (.glb, or .gltf with OUT.bin and pictures in OUT-pages/).

    images  "png"; "webp": EXT_texture_webp, required; "webp+png": WebP with PNG for readers that do not know it

    Raises what the reader raises for damaged files, and ExportTooLarge for a .glb of 4 GiB or more.
    """
    kinds, whole = IMAGES[images], out.suffix == ".glb"
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.stem}-") as scratch:
        made = Path(scratch)
        document, rects, triangles = _geometry(placement, selection, made)
        files = _pictures(placement, document, rects, kinds, made, out, embed=whole)
        _materials(document, list(rects), kinds)
        with (made / "bin").open("ab") as file:
            _align(file, 4)
        length = (made / "bin").stat().st_size
        document["buffers"] = [{"byteLength": length}]
        if whole:
            _write_glb(out, document, made / "bin", length)
        else:
            document["buffers"][0]["uri"] = f"{out.stem}.bin"
            files = [(made / "bin", out.with_suffix(".bin")), *files]
            text = made / "json"
            text.write_bytes(_json(document))
            for source, target in [*files, (text, out)]:
                target.parent.mkdir(exist_ok=True)
                source.replace(target)
    written = [out, *(target for _, target in files)]
    return Exported(
        files=written, impostors=len(selection.shown), triangles=triangles, pages=len(rects),
        bytes=sum(path.stat().st_size for path in written),
    )  # fmt: skip


def _geometry(placement: Placement, selection: Selection, made: Path) -> tuple[dict[str, Any], Rects, int]:
    """Write positions, texture coordinates and indices to the file `bin`; return (document, rects of pages, triangles)."""
    nodes: list[dict[str, Any]] = []
    meshes: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    rects: Rects = {}
    triangles = 0
    with (
        (made / "position").open("w+b") as position,
        (made / "uv").open("w+b") as uv,
        (made / "index").open("w+b") as index,
    ):
        streams = _Streams(position, uv, index)
        for impostor in _impostors(placement, selection):
            node: dict[str, Any] = {"name": f"impostor {impostor.id}", "translation": impostor.eye.tolist()}
            node["extras"] = _extras(impostor, selection)
            if impostor.layers:
                primitives = _primitives(impostor, placement, rects, accessors, streams)
                node["mesh"] = len(meshes)
                meshes.append({"name": node["name"], "primitives": primitives})
            triangles += sum(len(layer.uv) - 2 for layer in impostor.layers)
            nodes.append(node)
        views = []
        with (made / "bin").open("wb") as file:
            for stream, stride, target in ((position, 12, VERTICES), (uv, 8, VERTICES), (index, 0, INDICES)):
                start = file.tell()
                stream.seek(0)
                shutil.copyfileobj(stream, file)
                view: dict[str, Any] = {
                    "buffer": 0,
                    "byteOffset": start,
                    "byteLength": file.tell() - start,
                    "target": target,
                }
                views.append(view | ({"byteStride": stride} if stride else {}))
    number = {i: k for k, i in enumerate(selection.shown)}
    scenes: list[dict[str, Any]] = [{"name": selection.name, "nodes": list(range(len(nodes)))}]
    if len(selection.cells) > 1:
        scenes += [
            {"name": f"cell {c}", "nodes": [number[i] for i in selection.impostors_of[c]], "extras": {"cell": c}}
            for c in selection.cells
        ]
    document = {
        "asset": {"version": "2.0", "generator": f"farfield {version('farfield')}"},
        "extensionsUsed": ["KHR_materials_unlit"], "scene": 0, "scenes": scenes, "nodes": nodes, "meshes": meshes,
        "accessors": accessors, "bufferViews": views, "extras": {"farfield": _about(placement, selection)},
    }  # fmt: skip
    return document, rects, triangles


def _impostors(placement: Placement, selection: Selection) -> Iterator[Impostor]:
    """Yield the selected impostors in order of id, with no more than a few chunks in memory."""
    reader, held = fresh(placement), 0
    chunk = placement.index["impostor_chunk"]
    last = -1
    for i in selection.shown:
        if chunk[i] != last:
            last, held = int(chunk[i]), held + 1
        if held > 4:
            reader, held = fresh(placement), 1
        yield reader.impostors[i]


def _extras(impostor: Impostor, selection: Selection) -> dict[str, Any]:
    shown = selection.shown[impostor.id]
    return {
        "impostor": impostor.id, "objects": runs_of(impostor.objects.tolist()), "cells": shown.cells,
        "intervals": runs_of(shown.intervals), "problem_views": shown.views, "bytes": impostor.bytes,
        "cost": impostor.cost, "triangles": impostor.triangles,
    }  # fmt: skip


def _about(placement: Placement, selection: Selection) -> dict[str, Any]:
    """Return what a runtime needs besides: how cells and intervals are found, and whom the export is of."""
    manifest, index = placement.manifest, placement.index
    boxes = index["node_box"][index["cell_node"][selection.cells]] + placement.origin_m
    return {
        "runs": "[first, stop): ids from first to stop - 1", "budget": manifest["budget"], "camera": manifest["camera"],
        "quality": manifest["quality"], "interval_edges": manifest["interval_edges"],
        "cells": [{"cell": c, "box": box} for c, box in zip(selection.cells, boxes.tolist(), strict=True)],
        "placement": manifest["manifest_sha256"],
    }  # fmt: skip


def _primitives(
    impostor: Impostor, placement: Placement, rects: Rects, accessors: list[dict[str, Any]], out: _Streams
) -> list[dict[str, Any]]:
    """Write one impostor's polygons, near to far within a page, and return its primitives."""
    size = placement.manifest["page"]["size"]
    primitives = []
    for page in sorted({layer.page for layer in impostor.layers}):
        layers = [layer for layer in impostor.layers if layer.page == page]
        rects.setdefault(page, []).extend(layer.rect for layer in layers)
        position = np.concatenate([layer.position for layer in layers]).astype("<f4")
        uv = (np.concatenate([layer.uv for layer in layers]).astype(np.float64) / size).astype("<f4")
        first, fans = 0, []
        for layer in layers:
            n = len(layer.uv)
            fans.append([[first, first + k, first + k + 1] for k in range(1, n - 1)])
            first += n
        index = np.concatenate(fans).reshape(-1)
        kind, code = ("<u2", USHORT) if first < 65535 else ("<u4", UINT)
        _align(out.index, 4)
        for array, stream, accessor in (
            (position, out.position, {"bufferView": 0, "componentType": FLOAT, "count": first, "type": "VEC3",
                                      "min": position.min(0).tolist(), "max": position.max(0).tolist()}),
            (uv, out.uv, {"bufferView": 1, "componentType": FLOAT, "count": first, "type": "VEC2"}),
            (index.astype(kind), out.index, {"bufferView": 2, "componentType": code, "count": len(index), "type": "SCALAR"}),
        ):  # fmt: skip
            accessors.append(accessor | {"byteOffset": stream.tell()})
            stream.write(array.tobytes())
        at = len(accessors) - 3
        primitives.append(
            {
                "attributes": {"POSITION": at, "TEXCOORD_0": at + 1},
                "indices": at + 2,
                "material": list(rects).index(page),
            }
        )
    return primitives


def _pictures(
    placement: Placement, document: dict[str, Any], rects: Rects,
    kinds: tuple[str, ...], made: Path, out: Path, *, embed: bool,
) -> list[tuple[Path, Path]]:  # fmt: skip
    """Write every page in every format, one at a time, at the end of `bin` or to files; return (temporary, final) files."""
    images, files = [], []
    level = placement.manifest["page"]["levels"][0]
    with (made / "bin").open("ab") as file:
        for page in rects:
            texels = masked(placement.page(page), level, rects[page])
            for kind in kinds:
                content = encode(texels, kind)
                image: dict[str, Any] = {"name": f"page {page}"}
                if embed:
                    _align(file, 4)
                    document["bufferViews"].append({"buffer": 0, "byteOffset": file.tell(), "byteLength": len(content)})
                    image |= {"bufferView": len(document["bufferViews"]) - 1, "mimeType": f"image/{kind}"}
                    file.write(content)
                else:
                    name = f"{page:05}{SUFFIX[kind]}"
                    (made / name).write_bytes(content)
                    files.append((made / name, out.parent / f"{out.stem}-pages" / name))
                    image["uri"] = f"{out.stem}-pages/{name}"
                images.append(image)
    document["images"] = images
    return files


def _materials(document: dict[str, Any], pages: list[int], kinds: tuple[str, ...]) -> None:
    """Add a sampler, and a texture and a material a page."""
    document["samplers"] = [{"magFilter": NEAREST, "minFilter": NEAREST, "wrapS": CLAMP, "wrapT": CLAMP}]
    document["textures"], document["materials"] = [], []
    for k, page in enumerate(pages):
        source = {kind: len(kinds) * k + j for j, kind in enumerate(kinds)}
        texture: dict[str, Any] = {"sampler": 0, "name": f"page {page}"}
        if "png" in source:
            texture["source"] = source["png"]
        if "webp" in source:
            texture["extensions"] = {"EXT_texture_webp": {"source": source["webp"]}}
        document["textures"].append(texture)
        document["materials"].append({
            "name": f"page {page}", "alphaMode": "MASK", "alphaCutoff": 0.5,
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": k}, "metallicFactor": 0.0, "roughnessFactor": 1.0,
            },
            "extensions": {"KHR_materials_unlit": {}},
        })  # fmt: skip
    if "webp" in kinds:
        document["extensionsUsed"].append("EXT_texture_webp")
        if "png" not in kinds:
            document["extensionsRequired"] = ["EXT_texture_webp"]


def _write_glb(out: Path, document: dict[str, Any], binary: Path, length: int) -> None:
    text = _json(document)
    total = 12 + 8 + len(text) + 8 + length
    if total > MOST_GLB_BYTES:
        raise ExportTooLarge(out.name, total)
    part = binary.with_name("glb")
    with part.open("wb") as file, binary.open("rb") as body:
        file.write(struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", length, b"BIN\0"))
        shutil.copyfileobj(body, file)
    part.replace(out)


def _json(document: dict[str, Any]) -> bytes:
    """Return the document as ASCII JSON, padded to a multiple of four; lists that glTF forbids to be empty are left out."""
    kept = {key: value for key, value in document.items() if value != []}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")
    return text + b" " * (-len(text) % 4)


def _align(file: IO[bytes], to: int) -> None:
    file.write(b"\0" * (-file.tell() % to))
