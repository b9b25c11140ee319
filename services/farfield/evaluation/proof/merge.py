"""Join what the shards of a proof found: sums, the worst, and how much of all that a sample speaks for.

Share    With n pairs tried and f failed, `failing_share_upper` bounds the share of all pairs that fail, at the stated
         confidence.
After    Clopper and Pearson. The Use of Confidence or Fiducial Limits Illustrated in the Case of the Binomial. 1934.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

PICTURES = 4  # worst pairs that keep theirs


def badness(row: dict[str, Any]) -> tuple[Any, ...]:
    """Return what orders pairs, the worst highest."""
    return row["failed"], row["crack_px"], row["flip"], row["displacement_px"]


def merge_proofs(parts: Sequence[dict[str, Any]], *, confidence: float) -> dict[str, Any]:
    """Return one result of several `prove`, in order of their pairs. docs/formats/report.md lists its keys."""
    rows = [r for p in parts for r in p["rows"]]
    failed = [r for r in rows if r["failed"]]
    texels = sum(r["texels"] for r in rows)
    seen = [r for r in rows if r["seen_px"]]
    pixels = sum(r["seen_px"] for r in seen)
    worst = sorted(rows, key=badness, reverse=True)[:PICTURES]
    plain = lambda r: {k: v for k, v in r.items() if k != "displacement_sum_px"}  # noqa: E731
    return {
        "pairs": len(rows), "unseen": sum(p["unseen"] for p in parts), "impostors": len({r["impostor"] for r in rows}),
        "impostors_shown": max((p["impostors_shown"] for p in parts), default=0),
        "failed": len(failed), "failed_impostors": sorted({r["impostor"] for r in failed})[:100],
        "confidence": confidence, "failing_share_upper": upper_share(len(failed), len(rows), confidence),
        "allowed_px": parts[0]["allowed_px"] if parts else None, "pairs_in_view": len(seen),
        "pixels": sum(r["pixels"] for r in rows),
        "pixels_in_view": pixels, "texels": texels,
        "open_texels": sum(r["open_texels"] for r in rows), "wrong_texels": sum(r["wrong_texels"] for r in rows),
        "crack_px": sum(r["crack_px"] for r in rows),
        "hidden_px": sum(r["hidden_px"] for r in rows),
        "worst_displacement_px": max((r["displacement_px"] for r in rows), default=0.0),
        "mean_displacement_px": math.fsum(r["displacement_sum_px"] for r in rows) / texels if texels else 0.0,
        "flip": math.fsum(r["flip"] * r["seen_px"] for r in seen) / pixels if pixels else 0.0,
        "flip_p95": float(np.percentile([r["flip_p95"] for r in seen], 95)) if seen else 0.0,
        "worst": [plain(r) for r in worst], "renderer": parts[0]["renderer"] if parts else None,
        "not_proven": next((p["not_proven"] for p in parts if p.get("not_proven")), None),
    }  # fmt: skip


def upper_share(failed: int, tried: int, confidence: float) -> float:
    """Return the one-sided Clopper-Pearson bound of the share that fails; 1 where nothing was tried."""
    from scipy.stats import beta

    return 1.0 if failed >= tried else float(beta.ppf(confidence, failed + 1, tried - failed))
