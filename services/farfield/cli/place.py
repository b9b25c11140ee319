"""`farfield place SCENE --out DIR`: the whole job on this machine, without broker or database."""

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from farfield.cli.progress import stage_bars
from farfield.errors import FarfieldError, SceneNotAFile, SettingsInvalid
from farfield.executor import Executor
from farfield.settings import Settings, check, from_mapping
from farfield.stages import Stage
from farfield.steps.result import write_files

WRITTEN = ("scene.glb", "base.ffc", "report.json", "placement")  # what a job leaves in its folder


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("place", help="place, bake and verify impostors for a level")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="glTF, GLB, OBJ, PLY, STL, or a zip of one of these")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="writes DIR/placement, DIR/scene.glb, DIR/report.json"
    )
    parser.add_argument("--settings", type=Path, metavar="FILE.toml", help="settings (docs/settings.md)")
    parser.add_argument("--budget", help='"16 ms", "300 calls" or "200000 triangles"; wins over the file')
    parser.add_argument(
        "--device", metavar="NAME|FILE.toml", help="a preset, or what `farfield calibrate` wrote; wins over the file"
    )
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (default: one a core)"
    )
    parser.add_argument(
        "--cache", type=Path, metavar="DIR",
        help="keep the work of every stage here: the next job does only what its scene or settings changed",
    )  # fmt: skip
    parser.add_argument(
        "--from", type=Path, dest="base", metavar="DIR",
        help="keep what still holds of the placement in DIR, an earlier --out: only what it leaves unsolved is placed",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the report as JSON and nothing else")
    parser.set_defaults(run=run)


def load_settings(path: Path | None, budget: str | None, device: str | None = None) -> Settings:
    """Return checked settings from a TOML file (or defaults), with budget and device over it. Raises SettingsInvalid.

    device  a preset's name, or a file as `farfield calibrate` writes it
    """
    settings = from_mapping(_toml(path, "--settings")) if path is not None else Settings()
    if device is not None and device.endswith(".toml"):
        measured = from_mapping(_toml(Path(device), "--device"))
        if measured.device_profile is None:
            raise SettingsInvalid("--device", f"{device} has no table device_profile")
        settings = replace(settings, device=measured.device, device_profile=measured.device_profile)
    elif device is not None:
        settings = replace(settings, device=device, device_profile=None)
    if budget is not None:
        settings = replace(settings, budget=budget)
    check(settings)
    return settings


def _toml(path: Path, key: str) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsInvalid(key, f"{path} cannot be read: {error}") from error


def _work_folder(scene: Path, out: Path) -> Path:
    """Return a new empty folder in `out`. Refuses outputs that would replace the scene, or files that are no output."""
    replaced = [out / name for name in WRITTEN if (out / name).exists()]
    if scene.resolve() in [path.resolve() for path in replaced]:
        raise SettingsInvalid("--out", f"{scene} would be replaced; choose another folder")
    if replaced and not (out / "placement" / "manifest.json").is_file():
        raise SettingsInvalid("--out", f"{replaced[0]} is not of farfield and would be replaced; choose another folder")
    try:
        out.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=".work-", dir=out))
    except OSError as error:
        raise SettingsInvalid("--out", f"cannot be written to: {error}") from error


def _stop(number: int, frame: object) -> None:
    raise SystemExit(128 + number)


def run(args: argparse.Namespace) -> int:
    """Place the level; exit 0 when the placement is valid, 4 when it is done but not valid."""
    from farfield.evaluation.report import build_report

    if args.workers < 1:
        raise SettingsInvalid("--workers", "must be at least 1")
    settings = load_settings(args.settings, args.budget, args.device)
    if settings.placement.base is not None:
        raise SettingsInvalid("placement.base", "is what --from states; leave it out of the settings")
    if args.base is not None:
        from farfield.placementdb.base import open_base

        named = replace(settings.placement, base=open_base(args.base, settings).sha256)
        settings = replace(settings, placement=named)
        check(settings)
    if not args.scene.is_file():
        raise SceneNotAFile(f"{args.scene} is not a file")
    work = _work_folder(args.scene, args.out)
    signal.signal(signal.SIGTERM, _stop)  # so that a job that is told to end takes its work folder with it
    console = Console(stderr=True, quiet=args.json)
    try:
        with stage_bars(console) as bars:
            tasks = {stage: bars.add_task(stage, total=None, start=False, note="") for stage in Stage}

            def show(stage: Stage, done: int, total: int, skipped: str | None) -> None:
                bars.update(
                    tasks[stage], completed=done, total=max(total, 1), note=f"skipped: {skipped}" if skipped else ""
                )

            with Executor(
                args.scene, settings, work, workers=args.workers, progress=show, cache=args.cache, base=args.base
            ) as executor:  # fmt: skip
                for stage in Stage:
                    bars.start_task(tasks[stage])
                    try:
                        executor.run(stage)
                    except FarfieldError:
                        raise
                    except Exception:
                        # The placement stands without what would prove it, as `unproven`; anything else is a defect.
                        if stage not in (Stage.EVALUATION, Stage.PROOF):
                            raise
                        console.print_exception()
                    total = bars.tasks[tasks[stage]].total or 1
                    bars.update(tasks[stage], total=total, completed=total)
                    bars.stop_task(tasks[stage])
                    executor.begin_leaves()
                report = build_report(executor.inputs(*executor.paths.artifacts), executor.stages)
                write_files(executor.artifact(Stage.PLACEMENTDB), work / "done")
        text = json.dumps(report, indent=1, sort_keys=True) + "\n"
        (work / "done" / "report.json").write_text(text, encoding="utf-8")
        (args.out / "certificate.json").unlink(missing_ok=True)  # of what `farfield verify` found in the old placement
        for name in WRITTEN:  # all is written by now: what was there before is never replaced by half a placement
            old = args.out / name
            shutil.rmtree(old) if old.is_dir() else old.unlink(missing_ok=True)
            (work / "done" / name).rename(old)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    if args.json:
        json.dump(report, sys.stdout)
        print()
    else:
        from farfield.cli.report import show_report

        show_report(report)
    return 0 if report["verdict"] == "valid" else 4
