"""Extreme cases for a part of the pipeline alone: layers of one impostor, and the greedy over a million problem views."""

import math

import numpy as np

from farfield.candidates.model import BOX, Candidates
from farfield.impostor.metric import Setup, depth_range, place_layers, spacing

ALPHA = 1e-3
_PLAIN = {"t0": 10.0, "t_far": 20.0, "w": (8.0, 8.0), "res": (64.0, 64.0), "alpha_rad": ALPHA}


def _setup(is_box: bool = True, **more: object) -> Setup:
    return Setup(is_box=is_box, **(_PLAIN | more))  # type: ignore[arg-type]


SETUPS: tuple[tuple[str, Setup, str | None], ...] = (
    ("cell of zero size", _setup(), None),
    ("cell without depth", _setup(n=(4.0, 4.0)), None),
    ("cell without width", _setup(m=4.0), None),
    ("object touches the cell", _setup(t0=0.0, n=(4.0, 4.0)), "ObjectTouchesViewCell"),
    ("object begins inside the cell", _setup(t0=-1.0, n=(4.0, 4.0)), "ObjectTouchesViewCell"),
    ("t0 of 1e-300", _setup(t0=1e-300, n=(4.0, 4.0)), None),
    ("apex angle 0", _setup(False, n=(4.0, 4.0)), None),
    ("apex angle 1e-12 degrees", _setup(False, n=(4.0, 4.0), beta_deg=1e-12), None),
    ("apex angle 179.999999 degrees", _setup(False, n=(4.0, 4.0), beta_deg=179.999999), "OutOfDomain"),
    ("apex angle 180 degrees", _setup(False, n=(4.0, 4.0), beta_deg=180.0), "OutOfDomain"),
    ("resolution 1", _setup(n=(4.0, 4.0), m=4.0, res=(1.0, 1.0)), None),
    ("resolution 2", _setup(False, n=(4.0, 4.0), beta_deg=1e-9, res=(2.0, 2.0)), None),
    ("depth to infinity", _setup(n=(4.0, 4.0), t_far=math.inf), None),
    ("depth to infinity, shaft", _setup(False, n=(4.0, 4.0), beta_deg=11.25, t_far=math.inf), "OutOfDomain"),
    ("depth 0", _setup(n=(4.0, 4.0), m=4.0, t_far=10.0), None),
    ("near-equal layers", _setup(n=(4e3, 4e3), m=4.0, res=(4096.0, 4096.0), t_far=10.01), None),
    ("lengths of 1e150", Setup(is_box=True, t0=1e151, t_far=2e151, w=(8e150, 8e150), res=(64.0, 64.0), n=(4e150, 4e150),
                               m=4e150, alpha_rad=ALPHA), None),
    ("lengths of 1e-150", Setup(is_box=True, t0=1e-149, t_far=2e-149, w=(8e-150, 8e-150), res=(64.0, 64.0),
                                n=(4e-150, 4e-150), m=4e-150, alpha_rad=ALPHA), None),
    ("not a number", _setup(w=(math.nan, 8.0)), "OutOfDomain"),
)  # fmt: skip


def layers_of(setup: Setup) -> tuple[str, str]:
    """Return (how many layers there are, what is wrong with them): order, cover, no gap wider than the spacing."""
    layers = place_layers(setup)
    count = len(layers.t)
    outcome = f"{count} layers, s = {layers.s:g}, estimate {layers.estimate:g}"
    if not (count >= 1 and layers.near[0] == setup.t0 and layers.far[-1] == setup.t_far):
        return outcome, "the slabs do not cover the object"
    if count > 1 and not (np.diff(layers.t) > 0).all():
        return outcome, "layers are not in order"
    if not (layers.near[1:] == layers.far[:-1]).all() or count > layers.estimate + 1:
        return outcome, "slabs do not adjoin, or there are more than estimated"
    for t, after in zip(layers.t, layers.t[1:], strict=False):
        if after - t > spacing(setup, float(t), layers.s) * (1 + 1e-9):
            return outcome, f"a gap behind t = {t}"
    last = float(layers.t[-1])
    if count > 1 and last < setup.t_far and last + depth_range(setup, last, layers.s) < setup.t_far:
        return outcome, "the last layer does not serve to the end"
    return outcome, ""


def many_views(n_views: int, *, n_candidates: int = 3000, seed: int = 0) -> tuple[str, str]:
    """Return (how it ended, what is wrong) for the greedy over n_views problem views, each served by about ten candidates.

    No clusters nest, so that what is saved in a view is a plain sum: added up here from the choices alone.
    """
    from farfield.placement.choose import choose

    rng = np.random.default_rng(seed)
    length = 10 * n_views // n_candidates
    first = rng.integers(0, n_views - length, n_candidates)
    view = (first[:, None] + np.arange(length)).reshape(-1).astype(np.int32)
    saved = np.repeat(rng.integers(5, 200, n_candidates), length).astype(np.int64)
    candidates = Candidates(
        cluster=np.arange(n_candidates, dtype=np.int32), kind=np.full(n_candidates, BOX, np.uint8),
        view_cell=np.zeros((n_candidates, 9)), bytes=rng.integers(1000, 100_000, n_candidates),
        layers=np.ones(n_candidates, np.int32), cost=np.ones(n_candidates, np.int64),
        row=np.arange(n_candidates + 1, dtype=np.int64) * length, view=view, saved=saved,
    )  # fmt: skip
    reach = np.zeros(n_views, np.int64)
    np.add.at(reach, view, saved)
    excess = np.minimum(rng.integers(0, 400, n_views), reach)
    end = np.arange(1, n_candidates + 1, dtype=np.int32)
    choice = choose(candidates, excess=excess, end=end)
    chosen = np.isin(np.repeat(np.arange(n_candidates), length), choice.step)
    got = np.zeros(n_views, np.int64)
    np.add.at(got, view[chosen], saved[chosen])
    outcome = f"{n_views} views, {len(view)} entries: {len(choice.step)} of {n_candidates} candidates chosen"
    return outcome, "" if (got >= excess).all() else f"{int((got < excess).sum())} views over their target"
