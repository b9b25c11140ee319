"""The report states what was placed, and is plain JSON; the two verbs print it and refuse what is not there."""

import argparse
import hashlib
import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from farfield.cli import report as report_verb
from farfield.cli import verify as verify_verb
from farfield.columns import files_parts, pack
from farfield.detail.model import no_levels
from farfield.errors import ColumnsAltered, ColumnsTooNew, PlacementFileMissing, SettingsInvalid
from farfield.evaluation.proof.merge import merge_proofs
from farfield.evaluation.report import build_report
from farfield.evaluation.verify import verify
from farfield.placement.model import Bound
from farfield.placementdb.write import build_files
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from placements import glb, made_up
from rich.console import Console


@dataclass
class Inputs:
    settings: Settings
    artifacts: dict[Stage, Any]
    models: dict[Stage, Any]

    def get(self, stage: Stage) -> Any:
        return self.models[stage]


RAN = [
    SimpleNamespace(name="scene", seconds=1.25, peak_bytes=5_000_000, skipped=None, shards=1, reused=0),
    SimpleNamespace(
        name="visibility", seconds=0.0, peak_bytes=0, skipped="mode is off [by default]", shards=0, reused=0
    ),
]


def job(folder: Path, made: dict[str, Any], verified: bool = True) -> Inputs:
    """Write the finished job to `folder` and return what its report is built from."""
    level = glb(made["scene"])
    files = build_files(**made | {"digests": {"scene.glb": hashlib.sha256(level).hexdigest()}})
    files = {"scene.glb": level, **{f"placement/{name}": content for name, content in files.items()}}
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    artifacts: dict[Stage, Any] = {Stage.PLACEMENTDB: b"".join(bytes(p) for p in files_parts(files))}
    if verified:
        artifacts[Stage.EVALUATION] = pack("verified", {}, verify(folder, views=100))
        artifacts[Stage.PROOF] = pack("proof", {}, merge_proofs([], confidence=0.95))
    models = {
        Stage.SCENE: made["scene"], Stage.RENDERTIME: made["model"], Stage.VIEWSPACE: made["views"],
        Stage.REPAIR: made["placement"], Stage.BAKE: made["baked"],
        Stage.VISIBILITY: made["visible"], Stage.DETAIL: no_levels(),
        Stage.BOUND: Bound(method="lp", lower_bytes=400, placed_bytes=500, choices=89),
        Stage.CANDIDATES: SimpleNamespace(cluster=np.zeros(77)),
    }  # fmt: skip
    return Inputs(made["settings"], artifacts, models)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    folder = tmp_path_factory.mktemp("job")
    made = made_up(n_objects=60, n_impostors=12, budget=57, share=1.0, seed=2)
    report = build_report(job(folder, made), RAN)
    (folder / "report.json").write_text(json.dumps(report, allow_nan=False))
    return folder, made, report


def test_the_report_has_what_others_rely_on(finished: tuple[Path, dict[str, Any], dict[str, Any]]) -> None:
    folder, made, report = finished
    assert report["verdict"] == "infeasible"
    assert report["budget"] == "57 calls"
    counts = {
        "objects": 60, "triangles": 720, "cells": 16, "problem_views": 16 * 384, "candidates": 77, "impostors": 12,
        "hopeless_views": int(made["placement"].hopeless.sum()), "bytes": int(made["baked"].bytes.sum()),
        "lower_bound_bytes": 400, "seed": 0,
        "bound": {"method": "lp", "estimated_bytes": 500, "gap": 0.25, "choices": 89},
    }  # fmt: skip
    assert counts.items() <= report.items()
    files = [p for p in (folder / "placement").rglob("*") if p.is_file() and p.name != "manifest.json"]
    assert report["file_bytes"] == sum(p.stat().st_size for p in files if p.parent.name != "geometry")
    assert report["video_bytes"] == report["pages"] * 1024 * 1536 * 4
    assert report["settings"] == json.loads(json.dumps(to_mapping(made["settings"])))
    assert report["stages"][1] == {"name": "visibility", "seconds": 0.0, "peak_bytes": 0, "skipped": RAN[1].skipped,
                                   "shards": 0, "reused": 0}  # fmt: skip
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_hopeless_views_come_with_culprits_worst_first(finished: tuple[Path, dict[str, Any], dict[str, Any]]) -> None:
    _, made, report = finished
    best = [view["best"] for view in report["hopeless"]]
    assert best == sorted(best, reverse=True)
    assert len(best) == min(100, report["hopeless_views"])
    assert best[0] == made["placement"].view_best[made["placement"].hopeless].max() + 3
    first = report["hopeless"][0]
    assert [o["id"] for o in first["culprits"]] == [0, 1]
    assert first["culprits"][0]["name"] == "house 0"
    np.testing.assert_allclose(first["culprits"][0]["box"], made["scene"].object_box[0] + made["scene"].origin_m)
    assert report["culprits"][0]["hopeless_views"] == report["hopeless_views"]


def test_places_in_the_report_look_up_as_the_views_they_name(
    finished: tuple[Path, dict[str, Any], dict[str, Any]],
) -> None:
    from farfield.placementdb.read import Placement

    folder, _, report = finished
    placement = Placement.open(folder)
    for view in report["hopeless"] + report["worst_views"]:
        v = placement.lookup(view["position"], view["direction"])
        assert (v.problem_view, v.cell, v.interval) == (view["problem_view"], view["cell"], view["interval"])
        assert v.cost_bound == view["cost_bound"]


def test_no_evaluation_and_a_refuted_one_are_unproven(tmp_path: Path) -> None:
    made = made_up(n_objects=60, budget=64, share=0.01)
    assert build_report(job(tmp_path, made), RAN)["verdict"] == "valid"
    report = build_report(job(tmp_path, made, verified=False), RAN)
    assert (report["verdict"], report["verified"]) == ("unproven", None)
    for found in (None, {"failed": 1}):  # its proof crashed, or an impostor does not look like its geometry
        done = job(tmp_path, made)
        del done.artifacts[Stage.PROOF]
        if found:
            done.artifacts[Stage.PROOF] = pack("proof", {}, found)
        report = build_report(done, RAN)
        assert (report["verdict"], report["proof"]) == ("unproven", found)
    lie = made_up(n_objects=60, budget=6, share=0.0, n_impostors=0)
    assert build_report(job(tmp_path / "lie", lie), RAN)["verdict"] == "unproven"


def test_a_scene_within_budget_has_a_report(tmp_path: Path) -> None:
    made = made_up(budget=100, share=0.0, n_impostors=0)
    report = build_report(job(tmp_path, made), RAN)
    assert (report["verdict"], report["hopeless"], report["worst_views"]) == ("valid", [], [])
    assert report["smallest_budget"] == {"amount": 100, "text": "100 calls"}
    shown = io.StringIO()
    report_verb.show_report(report, Console(file=shown, width=120))
    assert "valid" in shown.getvalue()


def test_a_budget_in_milliseconds_is_rounded_up(tmp_path: Path) -> None:
    made = made_up(n_impostors=3)
    made["model"] = replace(made["model"], unit="ns", budget=16_000_000)
    made["placement"] = replace(made["placement"], smallest_budget=17_123_456)
    assert build_report(job(tmp_path, made), RAN)["smallest_budget"] == {"amount": 17_123_456, "text": "17.13 ms"}
    made["placement"] = replace(made["placement"], smallest_budget=10**13 + 1)  # no "1e+07 ms", and not rounded down
    assert build_report(job(tmp_path, made), RAN)["smallest_budget"]["text"] == "10000000.01 ms"


def arguments(module: Any, *argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers())
    return parser.parse_args(list(argv))


def test_verbs_print_json_and_nothing_else(
    finished: tuple[Path, dict[str, Any], dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _, report = finished
    args = arguments(report_verb, "report", str(folder), "--json")
    assert args.run(args) == 0
    assert json.loads(capsys.readouterr().out) == report
    args = arguments(verify_verb, "verify", str(folder), "--views", "50", "--seed", "3", "--json")
    assert args.run(args) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["views"], found["over_budget"]) == (50, 0)
    assert {"worst_ratio", "worst_view"} <= set(found)


def test_verbs_print_for_people(
    finished: tuple[Path, dict[str, Any], dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _, report = finished
    args = arguments(report_verb, "report", str(folder))
    args.run(args)
    text = capsys.readouterr().out
    assert "infeasible" in text
    assert "skipped: mode is off [by default]" in text
    assert report["smallest_budget"]["text"] in text
    args = arguments(verify_verb, "verify", str(folder), "--views", "20")
    args.run(args)
    assert "over_budget" in capsys.readouterr().out


def test_verify_exits_4_when_refuted(tmp_path: Path) -> None:
    job(tmp_path, made_up(n_objects=60, budget=6, share=0.0, n_impostors=0), verified=False)
    args = arguments(verify_verb, "verify", str(tmp_path), "--views", "50", "--json")
    assert args.run(args) == 4


def test_bad_use_and_missing_files_are_refused(tmp_path: Path) -> None:
    for argv in (["--views", "0"], ["--seed", "-1"], ["--bound", "-1"]):
        args = arguments(verify_verb, "verify", str(tmp_path), *argv)
        with pytest.raises(SettingsInvalid):
            args.run(args)
    for module, verb in ((verify_verb, "verify"), (report_verb, "report")):
        args = arguments(module, verb, str(tmp_path))
        with pytest.raises(PlacementFileMissing):
            args.run(args)
    for text, error in (("{", ColumnsAltered), ("[]", ColumnsAltered),
                        ('{"format": "farfield report", "version": 2}', ColumnsTooNew)):  # fmt: skip
        (tmp_path / "report.json").write_text(text)
        with pytest.raises(error):
            report_verb.read_report(tmp_path / "report.json")
