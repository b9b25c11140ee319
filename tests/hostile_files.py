"""Levels made to hurt: each is a way in which a reader has been brought down somewhere."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from hostile import lying_png, zipped
from levels import BOX_CORNERS, BOX_FACES, Gltf, box_level, pack_glb, png


def box() -> Gltf:
    """Return a document with one plain box."""
    level = Gltf()
    level.node(mesh=level.mesh(level.primitive(BOX_CORNERS, BOX_FACES)))
    return level


def edited(**more: Any) -> bytes:
    """Return a box whose document has these keys."""
    level = box()
    level.document |= more
    return level.glb()


def textured(image: bytes, mime: str = "image/png") -> bytes:
    """Return a box with this image on it."""
    level = box_level()
    level.document["images"][0] = {"bufferView": level.view(image), "mimeType": mime}
    return level.glb()


def hostile_files() -> Iterator[tuple[str, bytes]]:
    """Yield (file name, bytes): what is quickly read, or quickly refused."""
    yield from _counts()
    yield from _graphs()
    yield from _images()
    yield from _addresses()
    yield from _texts()
    yield from _zips()
    yield from _soups()


def heavy_files() -> Iterator[tuple[str, bytes]]:
    """Yield those that take seconds each: to be made, or to be refused."""
    yield "instances.glb", edited(nodes=[{"mesh": 0}] * 50_000, scenes=[{"nodes": list(range(50_000))}])
    level = box()
    level.document["meshes"][0]["primitives"] *= 50_000
    yield "primitives.glb", level.glb()
    yield "gray-bomb.glb", textured(lying_png(8192, 8192, rows=bytes(4 * 8192 + 1) * 8192))
    yield "bomb.zip", zipped({"a.obj": b"v 0 0 0\n" * 20_000_000})
    level, zeros = box().glb(), bytes(200 << 20)
    yield "bomb-beside.zip", zipped({"a.glb": level, "b.bin": zeros})
    yield "many.zip", zipped({f"{i}.txt": b"" for i in range(20_000)} | {"a.glb": level}, method=zipfile.ZIP_STORED)
    yield "bzip2-bomb.zip", zipped({"a.glb": zeros}, method=zipfile.ZIP_BZIP2)
    angles = np.linspace(0, 2 * np.pi, 60_000, endpoint=False)
    radius = 1 + 0.5 * (np.arange(len(angles)) % 2)  # a star: as concave as can be
    star = "\n".join(f"v {r * np.cos(a):.9g} {r * np.sin(a):.9g} 0" for a, r in zip(angles, radius, strict=True))
    yield "star.obj", f"{star}\nf {' '.join(map(str, range(1, len(angles) + 1)))}\n".encode()
    small = "\n".join(
        f"v {r * np.cos(a * 300):.9g} {r * np.sin(a * 300):.9g} 0"
        for a, r in zip(angles[:200], radius[:200], strict=True)
    )
    yield "stars.obj", (small + "\n" + f"f {' '.join(map(str, range(1, 201)))}\n" * 2000).encode()
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    yield "objects.obj", (triangle + "".join(f"o {i}\nf 1 2 3\n" for i in range(20_000))).encode()
    yield "materials.obj", (triangle + "".join(f"usemtl {i}\nf 1 2 3\n" for i in range(30_000))).encode()
    yield "mtllibs.obj", (triangle + "mtllib a.mtl b.mtl\n" * 100_000 + "f 1 2 3\n").encode()
    yield "line.obj", (triangle + "f 1 2 3" + " " * 30_000_000).encode()
    yield "continued.obj", (triangle + "f 1 2 3\\\n" * 1_000_000).encode()
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    )
    lists = "element face 300000\nproperty list uchar int vertex_indices\nend_header\n"
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4").tobytes()
    mixed = b"".join(bytes([n]) + np.arange(n, dtype="<i4").tobytes() for n in (3, 4) * 150_000)
    yield "mixed.ply", (head + lists).encode() + corners + mixed
    facet = b"facet normal 0 0 1\nouter loop\n"
    yield "stl-open.stl", b"solid a\n" + facet * 200_000
    yield "stl-words.stl", b"solid " + b"vertex 1 2 " * 500_000
    yield "stl-solids.stl", b"solid a\nendsolid a\n" * 100_000


def _counts() -> Iterator[tuple[str, bytes]]:
    for i, count in enumerate((2**31, 10**18, 500_000_000, -1, 1e300, "7", None)):
        level = box()
        level.document["accessors"][0] |= {"count": count}
        yield f"count-{i}.glb", level.glb()
        level.document["accessors"][0].pop("bufferView")  # zero-filled: nothing in the file bounds it
        yield f"zeros-{i}.glb", level.glb()
    for i, (n, indices) in enumerate([(1, [99]), (9, [0, 1]), (10**9, [0]), (2, [1, 1]), (2, [2**32 - 1, 0])]):
        level = box()
        at = level.view(np.array(indices, dtype="<u4").tobytes())
        values = level.view(np.full((len(indices), 3), 5, dtype="<f4").tobytes())
        sparse = {"count": n, "indices": {"bufferView": at, "componentType": 5125}, "values": {"bufferView": values}}
        level.document["accessors"][0]["sparse"] = sparse
        yield f"sparse-{i}.glb", level.glb()
    for i, more in enumerate([{"byteOffset": 2**63}, {"byteStride": 2**40}, {"byteLength": 2**62}, {"byteStride": 1}]):
        level = box()
        level.document["bufferViews"][0] |= more
        yield f"view-{i}.glb", level.glb()
    for i, index in enumerate(
        [np.full(36, 2**32 - 1, "<u4"), np.array([0, 1, 8], "<u2"), np.array([0.0, 1, 2], "<f4")]
    ):
        level = Gltf()
        level.node(mesh=level.mesh(level.primitive(BOX_CORNERS, index)))
        yield f"index-{i}.glb", level.glb()
    for i, value in enumerate([np.nan, np.inf, -np.inf, 3e38, 1e-42]):
        corners = BOX_CORNERS.copy()
        corners[3, 1] = value
        level = Gltf()
        level.node(mesh=level.mesh(level.primitive(corners, BOX_FACES)))
        yield f"position-{i}.glb", level.glb()
    for i, extension in enumerate([
        {"buffer": 0, "byteLength": 60, "byteStride": 12, "count": 2**40, "mode": "ATTRIBUTES"},
        {"buffer": 0, "byteLength": 60, "byteStride": 4, "count": 2**28, "mode": "TRIANGLES"},
        {"buffer": 0, "byteLength": 60, "byteStride": 256, "count": 5, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL"},
        {"buffer": 9, "byteLength": -1, "byteStride": 0, "count": 0, "mode": "NONE"},
    ]):  # fmt: skip
        level = box()
        level.document["extensionsRequired"] = level.document["extensionsUsed"] = ["EXT_meshopt_compression"]
        level.document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": extension}
        yield f"meshopt-{i}.glb", level.glb()


def _graphs() -> Iterator[tuple[str, bytes]]:
    deep = [{"children": [i + 1]} for i in range(100_000)] + [{"mesh": 0}]
    yield "deep.glb", edited(nodes=deep, scenes=[{"nodes": [0]}])
    yield "cycle.glb", edited(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}], scenes=[{"nodes": [0]}])
    yield "itself.glb", edited(nodes=[{"children": [0], "mesh": 0}], scenes=[{"nodes": [0]}])
    yield "laughs.glb", edited(nodes=[*({"children": [i + 1] * 10} for i in range(30)), {"mesh": 0}])
    yield "no-root.glb", edited(nodes=[{"children": [1]}, {"children": [0]}], scenes=[{}])
    far = [{"mesh": 0, "translation": [1e30 * (-1) ** i, 0, 0]} for i in range(2)]
    yield "far.glb", edited(nodes=far, scenes=[{"nodes": [0, 1]}])
    yield "shear.glb", edited(nodes=[{"mesh": 0, "matrix": [1e308] * 16}])
    grow = [{"children": [i + 1], "scale": [1e30] * 3} for i in range(40)] + [{"mesh": 0}]
    yield "grow.glb", edited(nodes=grow, scenes=[{"nodes": [0]}])
    yield "scale-0.glb", edited(nodes=[{"mesh": 0, "scale": [0, 0, 0]}])
    yield "rotation-0.glb", edited(nodes=[{"mesh": 0, "rotation": [0, 0, 0, 0]}])


def _images() -> Iterator[tuple[str, bytes]]:
    rows = bytes(4 * 16 + 1) * 16
    for i, (width, height) in enumerate([(60_000, 60_000), (2**31 - 1, 2**31 - 1), (8192, 8192), (16, 2**20), (0, 16)]):
        yield f"lying-{i}.glb", textured(lying_png(width, height, rows=rows))
    comment = zlib.compress(bytes(64 << 20))
    kinds = ((b"zTXt", b"a\0\0" + comment), (b"iCCP", b"a\0\0" + comment), (b"iTXt", b"a\0\1\0\0\0" + comment))
    for kind, body in kinds:
        whole = png()
        chunk = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        yield f"{kind.decode()}.glb", textured(whole[:33] + chunk + whole[33:])
    for name, data in (
        ("jpeg", b"\xff\xd8\xff\xc0\x00\x11\x08\xff\xff\xff\xff\x03\x01\x11\x00\x02\x11\x00\x03\x11\x00" + bytes(99)),
        ("webp", b"RIFF\x1a\0\0\0WEBPVP8L\x0d\0\0\0\x2f\xff\xff\xff\x0f" + bytes(9)),
        ("svg", b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "b"><!ENTITY c "&b;&b;">]><svg>&c;</svg>'),
        ("tiff", b"II*\0\x08\0\0\0\xff\xff" + bytes(60)), ("ico", b"\0\0\1\0\xff\xff" + bytes(60)), ("none", b""),
        ("eps", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 99999 99999\n"),
    ):  # fmt: skip
        yield f"{name}.glb", textured(data)


def _addresses() -> Iterator[tuple[str, bytes]]:
    for i, uri in enumerate([
        "file:///etc/passwd", "http://127.0.0.1:1/a.bin", "https://example.com/a", "//host/share/a", "/etc/passwd",
        "../../../../etc/passwd", "..%2f..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e/etc/passwd", "C:\\a.bin", "\\\\host\\a",
        "a\0b", "", " ", "data:;base64,****", "data:application/octet-stream;base64", "javascript:1", ".", "a/../../b",
        "a" * 100_000, "/proc/self/environ", "/dev/zero", "gopher:a",
    ]):  # fmt: skip
        document = json.loads(box().gltf())
        document["buffers"][0]["uri"] = uri
        yield f"buffer-{i}.gltf", json.dumps(document).encode()
        level = box_level()
        level.document["images"][0] = {"uri": uri}
        yield f"image-{i}.glb", level.glb()
        yield f"mtllib-{i}.obj", f"mtllib {uri}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode("utf-8", "replace")
    for i, wish in enumerate(["KHR_draco_mesh_compression", "EXT_no_such", 7, "KHR_texture_basisu"]):
        yield f"extension-{i}.glb", edited(extensionsRequired=[wish])


def _texts() -> Iterator[tuple[str, bytes]]:
    whole = json.loads(box().gltf())
    yield "nested.gltf", b'{"asset":' + b"[" * 2_000_000
    yield "nested-objects.gltf", b'{"a":' * 500_000 + b"1" + b"}" * 500_000
    yield "digits.gltf", b'{"asset":{"version":"2.0"},"nodes":[' + b"9" * 1_000_000 + b"]}"
    yield "nan.gltf", json.dumps({**whole, "nodes": [{"mesh": 0, "scale": [float("nan")] * 3}]}).encode()
    for i, name in enumerate(["\ud800", "a\0b\x1b[31m", "x" * 1_000_000, "../../etc", "<script>", "\u202e"]):
        level = box_level()
        level.document["nodes"][0]["name"] = level.document["materials"][0]["name"] = name
        level.document["asset"]["copyright"] = name
        yield f"name-{i}.glb", level.glb()
    for encoding in ("utf-16", "utf-32", "utf-8-sig", "utf-7"):
        yield f"{encoding}.gltf", box().gltf().decode().encode(encoding)
    for i, version in enumerate(("1.0", "3.0", 2, None, "2.0" * 999)):
        yield f"version-{i}.glb", edited(asset={"version": version})
    yield "second-json.glb", pack_glb(box().gltf(), b"")[:-8] + struct.pack("<I", 0) + b"JSON"
    yield "chunk-length.glb", b"glTF" + struct.pack("<III", 2, 20, 2**32 - 1) + b"JSON"
    yield "empty.glb", b""
    yield "zeros.glb", bytes(1000)


def _zips() -> Iterator[tuple[str, bytes]]:
    level = box().glb()
    yield "in-zip.zip", zipped({"inner.zip": zipped({"a.glb": level})})
    yield "in-zip-named.zip", zipped({"a.glb": zipped({"a.glb": level})})
    for i, name in enumerate(["../../a.glb", "/a.glb", "..\\..\\a.glb", "C:/a.glb", "a\nb.glb", "a" * 60_000 + ".glb"]):
        yield f"path-{i}.zip", zipped({name: level})
    for i, method in enumerate((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)):
        yield f"method-{i}.zip", zipped({"a.glb": level}, method=method)
    link = zipfile.ZipInfo("a.bin")
    link.external_attr, link.create_system = 0o120777 << 16, 3
    document = json.loads(box().gltf())
    document["buffers"][0]["uri"] = "a.bin"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as z:
        z.writestr("a.gltf", json.dumps(document))
        z.writestr(link, "/etc/passwd")
    yield "link.zip", out.getvalue()
    plain = bytearray(zipped({"a.glb": level}))
    central = plain.rindex(b"PK\x01\x02")
    for i, (at, value) in enumerate([
        (central + 8, b"\1\0"), (central + 10, b"\x63\0"), (central + 24, b"\xff" * 4), (central + 42, b"\xff" * 4),
        (central + 28, b"\xff\xff"), (central + 16, b"\0" * 4), (len(plain) - 14, b"\xff\xff"), (len(plain) - 6, b"\0" * 4),
    ]):  # fmt: skip
        data = bytearray(plain)
        data[at : at + len(value)] = value
        yield f"header-{i}.zip", bytes(data)
    yield "twice.zip", zipped({"a.glb": level}) + zipped({"b.glb": level})
    yield "prefixed.zip", bytes(5000) + bytes(plain)
    # One stream of zeros that many entries of the directory name: small, and terabytes when unpacked.
    entry = plain[central : plain.index(b"PK\x05\x06")]
    entry = entry[:24] + struct.pack("<I", 2**32 - 2) + entry[28:]
    end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 9999, 9999, 9999 * len(entry), central, 0)
    yield "overlapping.zip", bytes(plain[:central] + entry * 9999 + end)


def _soups() -> Iterator[tuple[str, bytes]]:
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    for i, face in enumerate(
        ["0 1 2", "1 2 99999999999999999999", "-1 -2 -9", "1/9/9 2 3", "1 2", "a b c", "1/1/1/1 2 3"]
    ):
        yield f"face-{i}.obj", f"{triangle}f {face}\n".encode()
    for i, vertex in enumerate(["nan 0 0", "1e400 0 0", "1", "", "0 0 0 0 0 0 0 0 0", "0x10 0 0", "1_0 0 0", "٣ 0 0"]):
        yield f"vertex-{i}.obj", f"v {vertex}\n{triangle}f 1 2 3\n".encode()
    head = (
        "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
    )
    lists = "property list {} int vertex_indices\nend_header\n"
    for i, (vertices, faces, kind) in enumerate([
        (2**32, 1, "uchar"), (10**15, 0, "uchar"), (3, 2**40, "uint"), (3, 1, "uint"), (-3, 1, "uchar"), (3, 1, "float"),
    ]):  # fmt: skip
        for order in ("ascii", "binary_little_endian", "binary_big_endian"):
            yield (
                f"ply-{i}-{order}.ply",
                (head.format(order, vertices, faces) + lists.format(kind)).encode() + b"\xff" * 64,
            )
    many = "".join(f"element e{i} 1\nproperty list uchar int a\n" for i in range(1500))
    yield "elements.ply", f"ply\nformat ascii 1.0\n{many}end_header\n".encode() + b"0 " * 1500
    nothing = (
        "ply\nformat binary_little_endian 1.0\nelement a 4000000000\nelement vertex 0\nproperty float x\nend_header\n"
    )
    yield "nothing.ply", nothing.encode()
    for i, count in enumerate((2**32 - 1, 10**6, 0)):
        yield f"stl-{i}.stl", bytes(80) + struct.pack("<I", count) + bytes(500)
    yield "stl-nan.stl", bytes(80) + struct.pack("<I", 1) + struct.pack("<12f", *[np.nan] * 12) + bytes(2)
