"""Measured frames, from a file or a request: numbers, or a named error with the row that has none.

A request is checked without numpy: it would be a sixth of the memory of an API process.
"""

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import SamplesInvalid

if TYPE_CHECKING:
    import numpy as np

COLUMNS = ("calls", "triangles", "pixels", "impostors", "impostor_triangles", "impostor_pixels")
MAX_SAMPLES = 20_000  # which take 4 s to fit
MOST = 1e15


def read_samples(path: Path) -> "np.ndarray":
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
    import numpy as np

    return np.array(samples_of(rows), dtype=np.float64).reshape(-1, len(COLUMNS) + 1)


def samples_of(rows: Any) -> list[list[float]]:
    """Return a row of COLUMNS and ms for each of a list of mappings. Raises SamplesInvalid with the row, counted from 1."""
    if not isinstance(rows, list):
        raise SamplesInvalid("the samples are no list of objects")
    if len(rows) > MAX_SAMPLES:
        raise SamplesInvalid(f"{len(rows)} samples are more than {MAX_SAMPLES}")
    return [[_number(row, name, i) for name in (*COLUMNS, "ms")] for i, row in enumerate(rows, 1)]


def _number(row: Any, name: str, i: int) -> float:
    value = row.get(name) if isinstance(row, dict) else None
    if value is None or isinstance(value, bool):
        raise SamplesInvalid(f"sample {i} has no {name}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise SamplesInvalid(f"sample {i}: {name} is no number: {value!r:.40}") from None
    if not 0 <= number <= MOST or (name == "ms" and number == 0):
        raise SamplesInvalid(f"sample {i}: {name} is {number:g}, which nothing can measure")
    return number
