"""The whole way at the size of the paper's Vienna, at its largest test, and at one and ten times a town.

Minutes each, so only with --bench-large. Every stage is a row: processor seconds, and where there are two sizes the
exponent (1.11 is 13 times the time for 10 times the town).
"""

import json
from pathlib import Path

import numpy as np
import pytest
from accept.measure import farfield
from benchmarks.conservative_stage import LEVELS
from benchmarks.measure import exponent
from benchmarks.scenes import CELL_M, munich, settings_text, vienna
from benchmarks.test_conservative import SCENES
from benchmarks.walk import Taken, read_settings, walk
from cutout import demo_city
from farfield.columns import unpack_dataclass
from farfield.executor import Executor, map_file
from farfield.settings import Settings, ViewSpaceSettings, VisibilitySettings
from farfield.stages import Stage
from farfield.viewspace.model import ProblemViews
from farfield.visibility.model import VisibleSets

SHARDED = (Stage.VISIBILITY, Stage.VIEWSPACE, Stage.CANDIDATES, Stage.BAKE, Stage.EVALUATION, Stage.PROOF)


def taken(scene: Path, toml: str, folder: Path, *, until: Stage = Stage.PLACEMENT) -> tuple[list[Taken], int]:
    """Return what each stage took, and the number of problem views."""
    settings = folder / "settings.toml"
    settings.write_text(toml, encoding="utf-8")
    rows = list(walk(scene, read_settings(settings), folder, until=until))
    views = unpack_dataclass(ProblemViews, map_file(folder / f"{Stage.VIEWSPACE}.ffc"))
    return rows, len(views.cell)


def report_all(report, name: str, rows: list[Taken], small: list[Taken] | None = None) -> None:
    for k, row in enumerate(rows):
        if row.shards:
            grown = small is not None and small[k].seconds > 0
            report(
                stage=row.stage, work=f"{row.shards} shards, {row.two_workers:.2f} times with two workers",
                input=f"{name}, peak {row.peak_bytes / 2**20:.0f} MiB", seconds=row.seconds,
                rate=row.artifact_bytes / row.seconds, unit="B/s",
                exponent=exponent([1, 10], [small[k].seconds, row.seconds]) if grown else None,
                sizes="towns 1..10" if grown else "",
            )  # fmt: skip


@pytest.mark.parametrize("mode, budget", [("off", "2700 calls"), ("sampled", "140 calls")])
def test_vienna(mode, budget, tmp_path, report):
    scene, boxes = vienna()
    rows, views = taken(scene, settings_text(boxes, budget=budget, mode=mode), tmp_path)
    report_all(report, f"Vienna's size, {mode}, {views} views", rows)


def test_many_views(tmp_path, report):
    """The demo city's street level without visibility: as many problem views as the largest test of the paper."""
    city = demo_city()
    raw, _ = city.read_city()
    scene = tmp_path / "city.glb"
    city.build(scene, tmp_path / "demo.toml")
    rows, views = taken(scene, settings_text(city.street_boxes(raw), budget="860 calls"), tmp_path)
    report_all(report, f"San Francisco, off, {views} views", rows)


def test_whole_city(tmp_path, report):
    """All streets of San Francisco as view space, default camera, with bake, by the command and two workers: wall clock."""
    city = demo_city()
    raw, materials = city.read_city()
    scene, toml = tmp_path / "city.glb", tmp_path / "settings.toml"
    city.write_city(scene, raw, materials)
    size = np.ptp(
        [c for mesh in raw.meshes for part in mesh for c in (part.position.min(0), part.position.max(0))], axis=0
    )
    boxes = city.street_boxes(raw, columns=tuple(np.ceil(size[[0, 2]] / CELL_M).astype(int).tolist()))
    toml.write_text(
        city.settings_text(boxes, budget="140 calls").replace('mode = "off"', 'mode = "sampled"'), encoding="utf-8"
    )
    out = str(tmp_path / "out")
    done = farfield("place", str(scene), "--settings", str(toml), "--workers", "2", "--json", "--out", out)
    assert done.code == 0, done.err
    told = json.loads(done.out)
    views = told["problem_views"]
    name = f"all of San Francisco, {told['cells']:,} cells, {views:,} problem views, {told['verdict']}"

    def add(stage: str, work: str, seconds: float) -> None:
        report(stage=stage, work=work, input=name, seconds=seconds, rate=views / seconds, unit="problem views/s")

    for stage in told["stages"]:
        if not stage["skipped"]:
            add(stage["name"], "wall clock, 2 workers", stage["seconds"])
    peak = f"wall clock, 2 workers, {done.peak_bytes / 2**30:.2f} GiB in all processes"
    add("all", peak, done.seconds)


@pytest.mark.parametrize("level", LEVELS)
def test_sampled(level, tmp_path, report):
    """Visibility by rays at its defaults, two workers, wall clock: means something only where nothing else runs."""
    name, cell_m, boxes = LEVELS[level]
    if not (SCENES / name).is_dir():
        pytest.skip(f"{name} is not on this machine")
    space, mode = ViewSpaceSettings(cell_m=cell_m, boxes=boxes), VisibilitySettings(mode="sampled")
    settings = Settings(view_space=space, visibility=mode)
    scene = SCENES / name / "scene.glb"
    with Executor(scene, settings, tmp_path, workers=2, progress=lambda *_: None) as executor:
        for stage in Stage:
            seconds = executor.run(stage).seconds
            if stage is Stage.VISIBILITY:
                break
        found = unpack_dataclass(VisibleSets, executor.artifact(Stage.VISIBILITY))
    stated = f"{found.missed_ppm_upper:.1f} ppm missed at most, p99 {found.p99_ppm:.0f}, {found.rays:,} rays"
    report(
        stage=Stage.VISIBILITY, work=f"wall clock, 2 workers: {stated}", input=f"{level}, {len(found.row) - 1:,} cells",
        seconds=seconds, rate=found.rays / seconds, unit="rays/s",
    )  # fmt: skip
    assert found.missed_ppm_upper < 50 and found.p99_ppm < 1000


def test_growth(tmp_path, report):
    rows = []
    for columns, across in ((1, 1), (5, 2)):
        scene, boxes = munich(columns, across, side=10)
        folder = tmp_path / f"{columns}x{across}"
        folder.mkdir()
        rows.append(taken(scene, settings_text(boxes, budget="20 calls", mode="sampled"), folder)[0])
    report_all(report, "10 towns, sampled", rows[1], rows[0])


def test_two_workers(tmp_path, report):
    """Wall clock, start of processes included: means something only where nothing else runs."""
    scene, boxes = munich(1, 1)
    toml = tmp_path / "settings.toml"
    toml.write_text(
        settings_text(boxes, budget="20 calls", mode="sampled") + '[placement]\nbound = "off"\n', encoding="utf-8"
    )
    settings, seconds = read_settings(toml), {}
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        folder.mkdir()
        with Executor(scene, settings, folder, workers=workers, progress=lambda *_: None) as executor:
            for stage in Stage:
                seconds[stage, workers] = executor.run(stage).seconds
    both = {n: sum(seconds[stage, n] for stage in SHARDED) for n in (1, 2)}
    for stage in (*SHARDED, None):
        one, two = (both[1], both[2]) if stage is None else (seconds[stage, 1], seconds[stage, 2])
        what = "all sharded stages" if stage is None else "wall clock"
        report(
            stage=stage or "visibility", work=f"{what}: two workers {one / two:.2f} times one",
            input="Munich, sampled", seconds=two, rate=one / two, unit="times one worker",
        )  # fmt: skip
    assert both[1] > both[2]
