"""`farfield calibrate SAMPLES --name X --out X.toml`: measured frames -> the profile of a device, as settings."""

import argparse
import dataclasses
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from farfield.errors import SettingsInvalid
from farfield.settings import COEFFICIENTS, DeviceProfile

_NAMED = {
    "per_frame_ns": "a frame", "per_call_ns": "a draw call", "per_triangle_ns": "a triangle", "per_pixel_ns": "a pixel",
    "per_impostor_ns": "an impostor", "per_impostor_triangle_ns": "a triangle of its layers",
    "per_impostor_pixel_ns": "a pixel of its layers",
}  # fmt: skip


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("calibrate", help="fit a device profile to measured frames")
    parser.add_argument("samples", type=Path, metavar="SAMPLES", help="CSV or JSON of frames (docs/calibration.md)")
    parser.add_argument("--name", help="what to call the device (default: the file's name)")
    parser.add_argument("--out", type=Path, metavar="FILE.toml", help="write the profile: `farfield place --device`")
    parser.add_argument("--json", action="store_true", help="print the profile as JSON and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fit; exit 0."""
    from farfield.rendertime.fit import fit_profile
    from farfield.rendertime.profiles import PROFILES
    from farfield.rendertime.samples import read_samples

    name = args.name or args.samples.stem
    if name in PROFILES:
        raise SettingsInvalid("--name", f"{name!r} is a preset; choose another name")
    profile = fit_profile(read_samples(args.samples))
    if args.out is not None:
        try:
            args.out.write_text(profile_text(name, profile), encoding="utf-8")
        except OSError as error:
            raise SettingsInvalid("--out", f"cannot be written: {error}") from error
    if args.json:
        json.dump({"device": name, "device_profile": dataclasses.asdict(profile)}, sys.stdout)
        print()
    else:
        show_profile(name, profile, Console())
    return 0


def profile_text(name: str, profile: DeviceProfile) -> str:
    """Return the profile as a settings file: TOML, `device` and its table."""
    fit = dataclasses.asdict(profile.fit) if profile.fit is not None else {}
    lines = [f"device = {json.dumps(name)}", "", "[device_profile]"]
    lines += [f"{key} = {getattr(profile, key)!r}" for key in COEFFICIENTS]
    if fit:
        lines += ["", "[device_profile.fit]", *(f"{key} = {value!r}" for key, value in fit.items())]
    return "\n".join(lines) + "\n"


def show_profile(name: str, profile: DeviceProfile, out: Console) -> None:
    """Print what drawing costs, and how the fit lies over its samples."""
    table = Table(title=name, title_style="bold", title_justify="left", show_header=False, box=None)
    for key, text in _NAMED.items():
        table.add_row(text, f"{getattr(profile, key):,.6g} ns")
    fit = profile.fit
    if fit is not None:
        table.add_row("samples", f"{fit.samples:,}")
        table.add_row("predicted - measured", f"mean {fit.mean_ms:.3f} ms, 95 % under {fit.p95_ms:.3f} ms")
        table.add_row("took longer than predicted", f"{fit.under_share:.1%}, at worst by {fit.worst_ms:.3f} ms")
        table.add_row("the same, frames not fitted to", f"{fit.unseen_under_share:.1%}")
    out.print(table, highlight=False)
