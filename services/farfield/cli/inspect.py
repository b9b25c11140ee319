"""`farfield inspect SCENE`: what is in a level, and which settings suggest themselves."""

import argparse
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

_MOST_OBJECTS = 10


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("inspect", help="show objects, warnings and suggested settings of a level")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="glTF, GLB, OBJ, PLY, STL, or a zip of one of these")
    parser.add_argument("--settings", type=Path, metavar="FILE.toml", help="settings (docs/settings.md)")
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="write DIR/inspect.json and, where it is quickly drawn, DIR/picture.png; print counts in place of lists",
    )  # fmt: skip
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the level and print what it holds; exit 0."""
    from farfield.cli.place import load_settings
    from farfield.scene.describe import describe, summary
    from farfield.scene.picture import picture_from_above
    from farfield.scene.read import inspect_scene

    scene, suggestion = inspect_scene(args.scene, settings=load_settings(args.settings, None))
    document = describe(scene, suggestion)
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "inspect.json").write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
        picture = picture_from_above(scene)
        if picture is not None:
            (args.out / "picture.png").write_bytes(picture)
    if args.json:
        print(json.dumps(document if args.out is None else summary(document), allow_nan=False))
    else:
        _show(document, args.scene.name, Console(highlight=False))
    return 0


def _show(document: dict[str, Any], name: str, console: Console) -> None:
    low, high = document["bounds"]
    size = " x ".join(f"{b - a:.4g}" for a, b in zip(low, high, strict=True))
    blended = sum(not o["replaceable"] for o in document["objects"])
    facts = Table(title=name, title_style="bold", show_header=False, box=None, title_justify="left")
    for key, value in (
        ("objects", f"{len(document['objects']):,} of {document['meshes']:,} meshes"),
        ("draw calls", f"{document['calls']:,}"),
        ("triangles", f"{document['triangles']:,}, {document['dropped_triangles']:,} without area dropped"),
        ("vertices", f"{document['vertices']:,}"),
        ("materials", f"{len(document['materials']):,}, {len(document['textures']):,} textures"),
        ("size", f"{size} m (x, y up, z)"),
        ("stays geometry", f"{blended:,} objects with blended materials"),
    ):
        facts.add_row(key, value)
    console.print(facts)

    largest = Table(title="most triangles", title_style="bold", title_justify="left", box=None)
    for column in ("id", "triangles", "calls"):
        largest.add_column(column, justify="right")
    largest.add_column("name", overflow="ellipsis", no_wrap=True)
    ranked = sorted(document["objects"], key=lambda o: (-o["triangles"], o["id"]))
    for o in ranked[:_MOST_OBJECTS]:
        largest.add_row(str(o["id"]), f"{o['triangles']:,}", str(o["calls"]), o["name"])
    console.print()
    console.print(largest)

    suggested = document["suggested"]
    space, why = suggested["view_space"], suggested["why"]
    count = len(space["boxes"])
    settings = Table(title="suggested settings", title_style="bold", title_justify="left", show_header=False, box=None)
    boxes = f"{count:,} boxes" if count > 1 else "1 box"
    settings.add_row("view_space.boxes", boxes, why["view_space.boxes"])
    settings.add_row("view_space.cell_m", f"{space['cell_m']:g}", why["view_space.cell_m"])
    settings.add_row("view_space.interval_deg", f"{space['interval_deg']:g}", why["view_space.interval_deg"])
    work = suggested["work"]
    settings.add_row(
        "work", f"{work['cells']:,} cells",
        f"x {work['directions']} directions = {work['views']:,} views, at most {_time(work['seconds'])} of one core to bound "
        "them all; what follows grows with the problem views among them",
    )  # fmt: skip
    settings.add_row("budget", " | ".join(suggested["budgets"]), why["budgets"])
    console.print()
    console.print(settings)
    for warning in document["warnings"]:
        console.print(f"warning: {warning}", markup=False)


def _time(seconds: float) -> str:
    for unit, length in (("hours", 3600), ("minutes", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} s"
