"""`farfield layers`: the layers of one centred impostor, from the error metric alone (docs: error metric, sections 1 to 8)."""

import argparse
import json
import math
from typing import Any

from farfield.impostor.metric import Setup, place_layers


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "layers",
        help="the layers of one impostor, from the error metric",
        description="Lengths in any one unit; distances from the view cell's face nearest the object.",
    )
    number: dict[str, Any] = {"type": float, "metavar": "X"}
    parser.add_argument("--cell", choices=("box", "shaft"), required=True, help="shape of the view cell")
    parser.add_argument("--t0", required=True, **number, help="distance of the object's near end, > 0")
    parser.add_argument("--depth", required=True, **number, help="depth of the object, >= 0 or inf")
    parser.add_argument("--w", required=True, **number, help="width of the object, > 0")
    parser.add_argument("--wy", **number, help="its height (default: --w)")
    parser.add_argument(
        "--res", required=True, type=float, metavar="N", help="texels across the width, >= 1; taken as given"
    )
    parser.add_argument("--resy", type=float, metavar="N", help="texels across the height (default: --res)")
    parser.add_argument(
        "--n", default=0.0, **number, help="width of the box cell, or of the shaft's near end (default: 0)"
    )
    parser.add_argument("--ny", **number, help="its height (default: --n)")
    parser.add_argument("--m", default=0.0, **number, help="depth of a box cell (default: 0)")
    parser.add_argument(
        "--beta", type=float, default=0.0, metavar="DEG", help="apex angle of a shaft, [0, 180) (default: 0)"
    )
    parser.add_argument("--s", default="auto", metavar="X", help="depth of the reference viewpoint, or auto (default)")
    parser.add_argument(
        "--alpha",
        type=float,
        metavar="RAD",
        help="admissible parallax angle (default: one texel at t0, 2 atan(w / (2 res t0)))",
    )
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.set_defaults(run=run, refuse=parser.error)


def run(args: argparse.Namespace) -> int:
    """Print count, estimate, s and the layers. Raises ObjectTouchesViewCell, OutOfDomain."""
    viewpoint = None
    if args.s != "auto":
        try:
            viewpoint = float(args.s)
        except ValueError:
            args.refuse(f"argument --s: {args.s!r} is neither a number nor auto")
    alpha = args.alpha
    if alpha is None:  # nan where it has no meaning, which the metric refuses by the name of its cause
        usable = args.t0 > 0 and args.res > 0 and args.w > 0
        alpha = 2 * math.atan(args.w / args.res / args.t0 / 2) if usable else math.nan
    setup = Setup(
        is_box=args.cell == "box", t0=args.t0, t_far=args.t0 + args.depth if args.depth >= 0 else -math.inf,
        w=(args.w, args.w if args.wy is None else args.wy), res=(args.res, args.res if args.resy is None else args.resy),
        n=(args.n, args.n if args.ny is None else args.ny), m=args.m, beta_deg=args.beta, alpha_rad=alpha,
    )  # fmt: skip
    found = place_layers(setup, s=viewpoint)
    rows = zip(found.t.tolist(), found.near.tolist(), found.far.tolist(), strict=True)
    layers = [{"t": _number(t), "near": _number(near), "far": _number(far)} for t, near, far in rows]
    document = {"count": len(layers), "estimate": found.estimate, "s": found.s, "layers": layers}
    if args.json:
        print(json.dumps(document))
        return 0
    print(f"{len(layers)} layers (bound in constant time: {found.estimate}), reference viewpoint s = {found.s:g}")
    print(f"{'t':>14} {'near':>14} {'far':>14}")
    for layer in layers:
        print(" ".join(f"{x:>14}" if isinstance(x, str) else f"{x:14.6g}" for x in layer.values()))
    return 0


def _number(x: float) -> float | str:
    return "inf" if x == math.inf else x
