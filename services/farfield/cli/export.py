"""`farfield export gltf DIR --out FILE`: the impostors of a placement as glTF, for other engines."""

import argparse
import json
from pathlib import Path

from farfield.errors import SettingsInvalid


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    verb = subparsers.add_parser("export", help="write a placement's impostors for other engines")
    formats = verb.add_subparsers(dest="export_format", required=True, metavar="FORMAT")
    parser = formats.add_parser("gltf", help="glTF 2.0: textured polygons, unlit, alpha masked")
    parser.add_argument("folder", type=Path, metavar="DIR", help="what `farfield place --out DIR` wrote")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help=".glb, or .gltf with FILE.bin and pictures beside it"
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--cell", type=int, metavar="ID", help="only what the views of this cell show (default: all)")
    which.add_argument(
        "--position", metavar="X,Y,Z", help="only what is shown from here, scene metres; with --direction"
    )
    parser.add_argument("--direction", metavar="X,Y,Z", help="looking along this; any length but 0")
    parser.add_argument(
        "--images", choices=("png", "webp", "webp+png"), default="png",
        help="pictures: PNG (default), WebP (EXT_texture_webp), or WebP with PNG for readers that do not know it",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Export. Raises SettingsInvalid, OutsideViewSpace, DirectionInvalid, NothingToExport, ExportTooLarge."""
    from farfield.export.gltf import export_gltf
    from farfield.export.select import select_all, select_cell, select_view
    from farfield.placementdb.read import Placement

    if args.out.suffix not in (".glb", ".gltf"):
        raise SettingsInvalid("--out", f"{args.out.name!r} must end with .glb or .gltf")
    if (args.position is None) != (args.direction is None):
        raise SettingsInvalid("--position", "goes with --direction: both, or neither")
    if not args.out.parent.is_dir():
        raise SettingsInvalid("--out", f"there is no folder {str(args.out.parent)!r}")
    placement = Placement.open(args.folder)
    if args.position is not None:
        selection = select_view(
            placement, _numbers("--position", args.position), _numbers("--direction", args.direction)
        )
    elif args.cell is not None:
        selection = select_cell(placement, args.cell)
    else:
        selection = select_all(placement)
    done = export_gltf(placement, selection, args.out, images=args.images)
    if args.json:
        print(json.dumps({
            "files": [str(path) for path in done.files], "impostors": done.impostors, "triangles": done.triangles,
            "pages": done.pages, "bytes": done.bytes,
        }))  # fmt: skip
    else:
        print(
            f"{selection.name}: {done.impostors} impostors, {done.triangles} triangles, {done.pages} pages, "
            f"{done.bytes / 1e6:.1f} MB in {len(done.files)} file{'s' if len(done.files) > 1 else ''}: {args.out}"
        )
    return 0


def _numbers(key: str, text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3:
        raise SettingsInvalid(key, f"{text!r} is not three numbers with commas between them")
    return found
