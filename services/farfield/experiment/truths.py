"""What a sweep's results are held against, as functions that a process of its own can be asked for."""

from pathlib import Path
from typing import Any

import numpy as np

FIT_SEED = 0


def bounds(folder: Path, views: int, seed: int) -> dict[str, Any]:
    """Return the ratios of bounds over the union and over the worst of dense cameras, of random problem views."""
    from farfield.evaluation.bound import bound_ratios
    from farfield.placementdb.read import Placement

    return bound_ratios(Placement.open(folder / "placement"), views=views, seed=seed)


def pictures(folder: Path, first: int, count: int, seed: int) -> dict[str, Any]:
    """Return what `prove_apart` does, without its pictures."""
    from farfield.evaluation.proof.prove import prove_apart

    found = prove_apart(folder, first, count, seed=seed, each=0)
    for row in found["rows"]:
        row["pictures"] = None
    return found


def fitted(samples: Path) -> list[dict[str, Any]]:
    """Return a row for each number of samples that a profile was fitted to: its errors on a quarter that none has seen."""
    from farfield.errors import FarfieldError
    from farfield.rendertime.fit import MIN_SAMPLES, fit_profile, predicted_ns
    from farfield.rendertime.samples import read_samples
    from farfield.settings import COEFFICIENTS

    frames = read_samples(samples)
    frames = frames[np.random.default_rng(FIT_SEED).permutation(len(frames))]
    held = frames[: len(frames) // 4]
    rest = frames[len(frames) // 4 :]
    rows: list[dict[str, Any]] = []
    counts = sorted(
        {n for n in (MIN_SAMPLES, 2 * MIN_SAMPLES, 4 * MIN_SAMPLES, 8 * MIN_SAMPLES) if n < len(rest)} | {len(rest)}
    )
    for n in counts:
        row: dict[str, Any] = {"name": f"{n} samples", "held_out": len(held), "mark": "", "why": None,
                               "cpu_seconds": float(rest[:n, -1].sum() / 1e3)}  # fmt: skip
        try:
            profile = fit_profile(rest[:n])
        except FarfieldError as error:
            rows.append({**row, "mean_ms": None, "p95_ms": None, "under_share": None, "why": str(error)})
            continue
        coefficient = np.array([float(getattr(profile, name)) for name in COEFFICIENTS])
        over = predicted_ns(held, coefficient) / 1e6 - held[:, -1]
        rows.append({**row, "mean_ms": float(over.mean()), "p95_ms": float(np.quantile(over, 0.95)),
                     "under_share": float((over < 0).mean())})  # fmt: skip
    return rows
