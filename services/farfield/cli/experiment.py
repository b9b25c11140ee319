"""`farfield experiment NAME SCENE`: figures about farfield on a level of yours, as a page, CSV and one JSON document."""

import argparse
import importlib
import json
import os
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from farfield.cli.place import load_settings
from farfield.errors import SceneNotAFile, SettingsInvalid

# Each module has HELP, SAID (its own flags), add_arguments(parser), build(job, args) -> document (experiment/document.py).
EXPERIMENTS = {
    "error-time": "farfield.experiment.error_time",
    "table1": "farfield.experiment.table1",
    "compare": "farfield.experiment.compare",
}


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb and what follows it."""
    parser = subparsers.add_parser("experiment", help="error against run time, the paper's tests, comparisons")
    names = parser.add_subparsers(dest="experiment", required=True, metavar="NAME")
    for name, module in EXPERIMENTS.items():
        experiment = importlib.import_module(module)
        one = names.add_parser(name, help=experiment.HELP, description=experiment.HELP)
        one.add_argument("scene", type=Path, metavar="SCENE", help="a level as `farfield place` takes it")
        one.add_argument("--out", type=Path, required=True, metavar="DIR",
                         help="writes DIR/index.html, DIR/report.json, a CSV a table, an SVG a plot")  # fmt: skip
        one.add_argument("--settings", type=Path, metavar="FILE.toml", help="the job's settings (docs/settings.md)")
        one.add_argument("--budget", help='"16 ms", "300 calls" or "200000 triangles"; wins over the file')
        one.add_argument("--device", metavar="NAME|FILE.toml", help="as of `farfield place`")
        one.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
        one.add_argument("--cache", type=Path, metavar="DIR",
                         help="where stages and measurements are kept and found again (default: cache in --out)")  # fmt: skip
        one.add_argument("--json", action="store_true", help="print report.json and nothing else")
        experiment.add_arguments(one)
        one.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run an experiment and write its files; exit 4 where it found a defect (a bound below the truth)."""
    from rich.console import Console

    from farfield.experiment.document import Job
    from farfield.experiment.files import write

    if args.workers < 1:
        raise SettingsInvalid("--workers", "must be at least 1")
    settings = load_settings(args.settings, args.budget, args.device)
    if not args.scene.is_file():
        raise SceneNotAFile(f"{args.scene} is not a file")
    experiment = importlib.import_module(EXPERIMENTS[args.experiment])
    console = Console(stderr=True, quiet=args.json)
    with console.status("") as status:
        started, last = time.monotonic(), ""

        def tell(text: str) -> None:
            nonlocal last
            passed = int(time.monotonic() - started)
            status.update(f"{passed // 60}:{passed % 60:02} {text}")
            what = text.partition(":")[0]
            if not console.is_terminal and what != last:  # a log: a line a job, not a bar
                console.out(f"{passed // 60}:{passed % 60:02} {what}", highlight=False)
            last = what

        job = Job(
            scene=args.scene, settings=settings, cache=args.cache or args.out / "cache", workers=args.workers, tell=tell,
            command=shlex.join(["farfield", "experiment", *_words(args, experiment.SAID)]),
        )  # fmt: skip
        document = experiment.build(job, args)
    written = write(document, args.out)
    if args.json:
        json.dump(document, sys.stdout)
        print()
    else:
        for section in document["sections"]:
            print(f"{section['title']}: {section['missing'] or section['text']}")
        print(f"\n{args.out / 'index.html'} and {len(written) - 1} more files")
    return 4 if document["defects"] else 0


def _words(args: argparse.Namespace, own: Sequence[str]) -> list[str]:
    """Return the command's words after `farfield experiment`, folders and files by their names only."""
    words = [args.experiment, args.scene.name]
    for flag in ("settings", "budget", "device", "workers", *own, "out"):
        value = getattr(args, flag.replace("-", "_"))
        if value is not None and value is not False:
            words += [f"--{flag}"] + [value.name if isinstance(value, Path) else str(value)] * (value is not True)
    return words
