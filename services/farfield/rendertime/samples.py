"""Measured frames, from a file or a request: numbers, or a named error with the row that has none."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import SamplesInvalid

COLUMNS = ("calls", "triangles", "pixels", "impostors", "impostor_triangles", "impostor_pixels")
MAX_SAMPLES = 20_000  # which take 4 s to fit


def read_samples(path: Path) -> np.ndarray:
    """Return (S,7) f64, COLUMNS and ms, from a CSV file with a header or a JSON list of objects; more keys are ignored.

    Raises SamplesInvalid.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        if text.lstrip()[:1] in ("[", "{"):
            rows = json.loads(text)
            rows = rows.get("samples") if isinstance(rows, dict) else rows
        else:
            rows = list(csv.DictReader(text.splitlines()))
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        raise SamplesInvalid(f"{path.name} cannot be read: {error}") from error
    return samples_of(rows)


def samples_of(rows: Any) -> np.ndarray:
    """Return (S,7) f64, COLUMNS and ms, of a list of mappings. Raises SamplesInvalid with the row, counted from 1."""
    if not isinstance(rows, list):
        raise SamplesInvalid("the samples are no list of objects")
    if len(rows) > MAX_SAMPLES:
        raise SamplesInvalid(f"{len(rows)} samples are more than {MAX_SAMPLES}")
    out = np.empty((len(rows), len(COLUMNS) + 1))
    for i, row in enumerate(rows):
        for k, name in enumerate((*COLUMNS, "ms")):
            value = row.get(name) if isinstance(row, dict) else None
            if value is None or isinstance(value, bool):
                raise SamplesInvalid(f"sample {i + 1} has no {name}")
            try:
                out[i, k] = float(value)
            except (TypeError, ValueError, OverflowError):
                raise SamplesInvalid(f"sample {i + 1}: {name} is no number: {value!r:.40}") from None
    bad = ~(np.isfinite(out) & (out >= 0) & (out <= 1e15))
    bad[:, -1] |= out[:, -1] <= 0
    if bad.any():
        i, k = (int(x) for x in np.argwhere(bad)[0])
        name, value = (*COLUMNS, "ms")[k], out[i, k]
        raise SamplesInvalid(f"sample {i + 1}: {name} is {value:g}, which nothing can measure")
    return out
