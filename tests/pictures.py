"""Pictures of a view in the browser, with impostors and as geometry alone, and what sets them apart."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

MAGENTA = (255, 0, 255)
SKY = [0.62, 0.74, 0.82]  # the viewer's own


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One view. Shares are of the picture's pixels."""

    stats: dict[str, Any]  # of the viewer's hook
    coverage: float  # share that shows an impostor
    flip: float  # mean over the covered pixels
    flip_picture: float  # mean over the whole picture
    holes: int  # pixels that are geometry in the truth, more than a pixel from its sky, and sky with impostors
    shown: np.ndarray  # (H,W,3) u1
    truth: np.ndarray


def picture(page: Any, method: str = "capture") -> np.ndarray:
    """Return (H,W,3) u1: what `farfield.capture()` or `farfield.coverage()` gives, at the placement's full size."""
    url = page.evaluate(f"farfield.{method}()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB"))


def set_view(page: Any, position: Sequence[float], direction: Sequence[float]) -> dict[str, Any]:
    """Go there, wait until all is resident, and return the hook's statistics."""
    page.evaluate("([p, d]) => farfield.setView(p, d)", [list(map(float, position)), list(map(float, direction))])
    return page.evaluate("farfield.stats()")


def compare(page: Any, position: Sequence[float], direction: Sequence[float]) -> Compared:
    """Return how the view with impostors differs from the view without. Leaves impostors on."""
    import flip_evaluator

    stats = set_view(page, position, direction)
    covered = picture(page, "coverage").any(-1)
    shown = picture(page)
    page.evaluate("farfield.setMode({background: [1, 0, 1]})")
    sky_shown = (picture(page) == MAGENTA).all(-1)
    page.evaluate("farfield.setMode({impostors: false})")
    sky_truth = (picture(page) == MAGENTA).all(-1)
    page.evaluate("background => farfield.setMode({background})", SKY)
    truth = picture(page)
    page.evaluate("farfield.setMode({impostors: true})")
    as_floats = [(p / 255).astype(np.float32) for p in (truth, shown)]
    errors = flip_evaluator.evaluate(*as_floats, "LDR", applyMagma=False)[0].reshape(covered.shape)
    return Compared(
        stats=stats, coverage=float(covered.mean()), flip=float(errors[covered].mean()) if covered.any() else 0.0,
        flip_picture=float(errors.mean()), holes=int((sky_shown & ~_grow(sky_truth)).sum()), shown=shown, truth=truth,
    )  # fmt: skip


def save(folder: Path, name: str, view: Compared) -> None:
    """Write NAME-shown.png and NAME-truth.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("shown", "truth"):
        Image.fromarray(getattr(view, kind)).save(folder / f"{name}-{kind}.png")


def _grow(mask: np.ndarray) -> np.ndarray:
    """Return the mask with its eight neighbours."""
    wide = np.pad(mask, 1)
    h, w = mask.shape
    return np.logical_or.reduce([wide[i : i + h, j : j + w] for i in range(3) for j in range(3)])
