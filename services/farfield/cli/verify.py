"""`farfield verify DIR`: try to refute a placement, from its files alone; what was tried goes to DIR/certificate.json."""

import argparse
import json
import sys
from pathlib import Path

from farfield.errors import SettingsInvalid


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("verify", help="cost random views of a finished placement against its budget")
    parser.add_argument("folder", type=Path, metavar="DIR", help="what `farfield place --out DIR` wrote")
    parser.add_argument("--views", type=int, default=10_000, metavar="N", help="views to try (default 10000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="which views (default 0)")
    parser.add_argument(
        "--climb", type=int, default=100, metavar="N",
        help="search for the worst view of N cells, the worst cells first (default 100)",
    )  # fmt: skip
    parser.add_argument(
        "--bound", type=int, default=0, metavar="N",
        help="also hold the bounds of N problem views against the union of dense cameras (default 0)",
    )  # fmt: skip
    parser.add_argument(
        "--pictures", type=int, default=0, metavar="N",
        help="also compare pictures with and without impostors, for N random (impostor, viewpoint) pairs (default 0)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Verify; exit 4 when a view refutes the placement."""
    from farfield.evaluation.certificate import build_certificate, write_certificate
    from farfield.evaluation.verify import refuted, verify

    for name, least in (("views", 1), ("seed", 0), ("climb", 0), ("bound", 0), ("pictures", 0)):
        if getattr(args, name) < least:
            raise SettingsInvalid(f"--{name}", f"must be at least {least}")
    found = verify(args.folder, views=args.views, seed=args.seed, climbs=args.climb)
    failed = refuted(found)
    if args.bound:
        from farfield.evaluation.bound import bound_over_union
        from farfield.placementdb.read import Placement

        found["bound"] = bound_over_union(Placement.open(args.folder), views=args.bound, seed=args.seed)
        failed = failed or found["bound"]["below_one"] > 0
    if args.pictures:
        from farfield.evaluation.proof.merge import merge_proofs
        from farfield.evaluation.proof.prove import prove_apart

        part = prove_apart(args.folder, 0, args.pictures, seed=args.seed, each=0)
        found["proof"] = merge_proofs([part], confidence=0.95)
        failed = failed or bool(found["proof"]["failed"])
    try:
        written = write_certificate(args.folder, build_certificate(args.folder, found, refuted=failed))
    except OSError as error:  # a placement on a read-only disk is verified all the same
        written = None
        print(f"certificate.json was not written: {error.strerror}", file=sys.stderr)
    if args.json:
        json.dump(found, sys.stdout)
        print()
    else:
        _show(found)
        if written:
            print(f"certificate   {written}")
    return 4 if failed else 0


def _show(found: dict) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_row("files", f"{found['files']} verified")
    table.add_row("views", f"{found['views']}, {found['in_problem_views']} of them in problem views")
    table.add_row("over_budget", str(found["over_budget"]))
    table.add_row("worst_ratio", f"{found['worst_ratio']:.4f} of {found['budget']} {found['unit']}")
    worst = found["worst_view"]
    if worst:
        at, along = (", ".join(f"{x:.3f}" for x in worst[key]) for key in ("position", "direction"))
        table.add_row("worst_view", f"at ({at}) along ({along})")
        table.add_row("", f"cost {worst['cost']}, bound {worst['cost_bound']}, cell {worst['cell']}, "
                          f"{worst['objects']} objects, {worst['impostors']} impostors")  # fmt: skip
    if (sought := found.get("climb")) and sought["cells"]:
        gain = sought["median_gain"]
        table.add_row(
            "climb", f"{sought['views']} more views in {sought['cells']} of {sought['of_cells']} cells: the worst went from "
            f"{sought['random_worst_ratio']:.4f} to {max(sought['worst_ratio'], sought['random_worst_ratio']):.4f}"
            + (f", a cell's worst at median {100 * (gain - 1):.1f} % up" if gain is not None else ""),
        )  # fmt: skip
    if (bound := found.get("bound")) and bound["views"]:
        over = bound["over_union"]
        table.add_row("bound", f"of {bound['views']} problem views, over the union of {bound['samples']} cameras each: "
                               f"median {over['median']:.4f}, {over['least']:.4f} to {over['most']:.4f}")  # fmt: skip
    if found["in_hopeless_views"]:
        ratio = found["worst_hopeless_ratio"]
        table.add_row("hopeless", f"{found['in_hopeless_views']} views fell into hopeless ones, worst {ratio:.4f}")
    if proof := found.get("proof"):
        table.add_row(
            "pictures",
            proof["not_proven"]
            or f"{proof['pairs']} pairs of {proof['impostors']} impostors, {proof['failed']} failed; "
            f"fewer than {100 * proof['failing_share_upper']:.2f} % fail, at {100 * proof['confidence']:g} % confidence",
        )
        table.add_row(
            "",
            f"{proof['crack_px']} crack pixels, displaced by at most {proof['worst_displacement_px']:.3f} px "
            f"(mean {proof['mean_displacement_px']:.3f}), FLIP {proof['flip']:.3f}",
        )
        if proof["failed"]:
            table.add_row("", f"failed: impostors {', '.join(map(str, proof['failed_impostors']))}")
    defects = {
        "too_coarse": "objects were drawn at a level that is too coarse for where they are",
        "over_bound": "views cost more than their stated bound",
        "outside_view_cell": "impostors were shown outside their view cell",
    }
    for key, text in defects.items():
        if found[key]:
            table.add_row(key, f"{found[key]} {text}: a defect, please report it")
    Console().print(table)
