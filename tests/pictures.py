"""Pictures of a view in the browser, with impostors and as geometry alone, and what sets them apart."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from farfield.bake.shade import DECODE
from PIL import Image

SLOW_M, FRAMES = 0.02, 6  # of a walk that shows what shimmers
THROUGH = 0.1  # of a pixel: less than one of its samples
SKY = [0.62, 0.74, 0.82]  # the viewer's own


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One view. Shares are of the picture's pixels."""

    stats: dict[str, Any]  # of the viewer's hook
    coverage: float  # share that shows an impostor
    flip: float  # mean over the covered pixels
    flip_picture: float  # mean over the whole picture
    holes: int  # pixels, see `holes_of`
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


def view_of(page: Any) -> tuple[list[float], list[float]]:
    """Return position and direction, without waiting for what is on its way."""
    parts = dict(part.split("=", 1) for part in page.evaluate("farfield.share()").lstrip("#").split("&"))
    position, direction = ([float(x) for x in parts[key].split(",")] for key in ("at", "to"))
    return position, direction


def flip(truth: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return (H,W) f4, 0 .. 1: what the flip-evaluator package says of two pictures (H,W,3) u1."""
    import flip_evaluator

    as_floats = [(p / 255).astype(np.float32) for p in (truth, shown)]
    return flip_evaluator.evaluate(*as_floats, "LDR", applyMagma=False)[0].reshape(truth.shape[:2])


def compare(page: Any, position: Sequence[float], direction: Sequence[float]) -> Compared:
    """Return how the view with impostors differs from the view without. Leaves impostors on."""
    stats = set_view(page, position, direction)
    covered = picture(page, "coverage").any(-1)
    shown = picture(page)
    through_shown = _through(page)
    page.evaluate("farfield.setMode({impostors: false})")
    through_truth = _through(page)
    truth = picture(page)
    page.evaluate("farfield.setMode({impostors: true})")
    errors = flip(truth, shown)
    return Compared(
        stats=stats, coverage=float(covered.mean()), flip=float(errors[covered].mean()) if covered.any() else 0.0,
        flip_picture=float(errors.mean()), holes=int(holes_of(through_shown, through_truth).sum()), shown=shown, truth=truth,
    )  # fmt: skip


def shimmer(page: Any, position: Sequence[float], direction: Sequence[float]) -> tuple[float, float]:
    """Return how much a frame of a slow walk forwards differs from the next, with impostors and with geometry.

    Means over the pixels that impostors cover in the first frame, of 0 .. 1. Leaves impostors on.
    """
    ahead = np.array([direction[0], 0.0, direction[2]]) / np.hypot(direction[0], direction[2])
    walk = [np.asarray(position) + SLOW_M * k * ahead for k in range(FRAMES)]
    set_view(page, walk[0].tolist(), direction)
    covered = picture(page, "coverage").any(-1)
    found = []
    for impostors in (False, True):
        page.evaluate("impostors => farfield.setMode({impostors})", impostors)
        frames = []
        for p in walk:
            set_view(page, p.tolist(), direction)
            frames.append(picture(page)[covered] / 255)
        found.append(float(np.abs(np.diff(np.array(frames), axis=0)).mean()))
    return found[1], found[0]


def holes_of(shown: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return (H,W) b1: pixels that let the background through (THROUGH) where the truth does nowhere within a pixel around.

    As the cracks of `farfield.evaluation.proof`. Edges may move by the pixel error, so a gap between two houses may be
    wider than in the truth, by up to that on each side; what is closed stays closed.

    shown, truth  (H,W) the share of each pixel that shows the background
    """
    return (shown > THROUGH) & (_most_around(truth) <= THROUGH)


def save(folder: Path, name: str, view: Compared) -> None:
    """Write NAME-shown.png and NAME-truth.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("shown", "truth"):
        Image.fromarray(getattr(view, kind)).save(folder / f"{name}-{kind}.png")


def _through(page: Any) -> np.ndarray:
    """Return (H,W) the share of each pixel that shows the background: what its light adds. Leaves SKY there."""
    light = []
    for level in (0, 1):
        page.evaluate("background => farfield.setMode({background})", [level] * 3)
        light.append(DECODE[picture(page)].mean(-1))
    page.evaluate("background => farfield.setMode({background})", SKY)
    return light[1] - light[0]


def _most_around(share: np.ndarray) -> np.ndarray:
    """Return the largest of each pixel and its eight neighbours."""
    wide = np.pad(share, 1)
    h, w = share.shape
    return np.maximum.reduce([wide[i : i + h, j : j + w] for i in range(3) for j in range(3)])
