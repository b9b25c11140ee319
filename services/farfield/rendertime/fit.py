"""Fit a device profile to measured frames, as an upper bound that 95 % of them do not exceed.

Problem  A sample says what a frame drew (calls, triangles, pixels, and the same of impostors) and how long it took. Find
         coefficients >= 0 such that what they predict is at least what was measured in 95 % of the samples, and
         otherwise as little above as possible: a budget kept on paper is then kept on the device.
Method   Quantile regression with non-negative coefficients, min sum of rho(ms - X b) with rho(r) = 0.95 r above and
         -0.05 r below 0, as its dual linear programme: seven rows, one bounded variable a sample (HiGHS); b are its
         multipliers. The constant per frame is one of them, so at the optimum raising it does not help: at most 5 % of
         the samples lie strictly above. Coefficients are then rounded up to four digits, and the constant is raised
         where arithmetic left a sample too many.
Errs     upwards, on frames like those measured. Five fits, each on four fifths of the samples, say how often the fifth
         that it did not see is under-estimated: that share is kept beside the one of the samples themselves.
After    Koenker and Bassett. Regression Quantiles. Econometrica 46, 1978. Wimmer and Wonka, EGSR 2003.
Tried    Least squares with non-negative coefficients, then lifted until 95 % lie below: on 400 made-up frames of 1 to 40
         ms whose noise grows with the load, a mean excess of 2.10 ms (lifted by a constant) or 1.73 ms (by a factor)
         against 1.62 ms, and the factor is right for such noise only.
"""

import numpy as np
from scipy.optimize import linprog

from farfield.errors import SamplesDegenerate, SamplesTooFew
from farfield.rendertime.samples import COLUMNS
from farfield.settings import COEFFICIENTS, MOST_NS, DeviceProfile, Fit

QUANTILE = 0.95
MIN_SAMPLES = 100
FOLDS = 5
_LOW, _HIGH = 5, 95  # percentiles between which a column has to vary: one odd frame is no variation
_SPREAD = 2.0  # times from the low to the high one
_APART = 1e-3  # least share of a column's variance that the others leave unexplained
_MS_SPREAD = 0.1  # of the median
_ADVICE = {
    "calls": "measure views with few and with many objects",
    "triangles": "measure a view with detailed objects beside one with as many plain ones",
    "pixels": "measure a view filled by near objects beside one of far objects",
    "impostors": "measure a placement with and without its impostors",
    "impostor_triangles": "measure impostors with few and with many layers",
    "impostor_pixels": "measure near and far impostors",
}


def fit_profile(samples: np.ndarray) -> DeviceProfile:
    """Return the profile of samples (S,7) f64 as `read_samples` returns them, with its residuals in `fit`.

    Raises SamplesTooFew, SamplesDegenerate: the message names every column that is to blame, and what to measure.
    """
    if len(samples) < MIN_SAMPLES:
        raise SamplesTooFew(f"{len(samples)} samples are too few for a quantile of seven; measure {MIN_SAMPLES}")
    faults = _faults(samples)
    if faults:
        raise SamplesDegenerate("; ".join(faults))
    coefficient = _quantile_fit(samples)
    if not coefficient[1:].any():
        raise SamplesDegenerate("no frame takes longer where it draws more; measure the time of the GPU, not a clock's")
    if coefficient.max() > MOST_NS:
        raise SamplesDegenerate(
            f"{COEFFICIENTS[int(coefficient.argmax())]} would be over a second; are the times milliseconds?"
        )
    over_ms = (predicted_ns(samples, coefficient) - samples[:, -1] * 1e6) / 1e6
    fold = np.arange(len(samples)) % FOLDS
    unseen = 0
    for k in range(FOLDS):
        rest = samples[fold == k]
        unseen += int((predicted_ns(rest, _quantile_fit(samples[fold != k])) < rest[:, -1] * 1e6).sum())
    return DeviceProfile(
        **dict(zip(COEFFICIENTS, (int(coefficient[0]), *coefficient[1:].tolist()))),
        fit=Fit(
            samples=len(samples), quantile=QUANTILE, mean_ms=round(float(over_ms.mean()), 6),
            p95_ms=round(float(np.quantile(over_ms, 0.95)), 6), worst_ms=round(float(max(0.0, -over_ms.min())), 6),
            under_share=float((over_ms < 0).mean()), unseen_under_share=unseen / len(samples),
        ),
    )  # fmt: skip


def _quantile_fit(samples: np.ndarray) -> np.ndarray:
    """Return (7,) f64 >= 0, nanoseconds: the constant and a coefficient a column, rounded up."""
    drawn = np.concatenate([np.ones((len(samples), 1)), samples[:, :-1]], axis=1)
    scale = drawn.max(0)
    ms = samples[:, -1]
    dual = linprog(
        -ms / ms.max(), A_ub=(drawn / scale).T, b_ub=np.zeros(drawn.shape[1]), bounds=(QUANTILE - 1, QUANTILE),
        method="highs-ds",
    )  # fmt: skip
    assert dual.status == 0, dual.message  # bounded, and 0 is feasible
    raw = np.maximum(-dual.ineqlin.marginals, 0.0) * ms.max() * 1e6 / scale
    raw[raw * scale < 1.0] = 0.0  # below a nanosecond in the fullest frame
    coefficient = np.array([_rounded_up(float(c)) for c in raw])
    short_ns = np.sort(ms * 1e6 - predicted_ns(samples, coefficient))
    allowed = int((1 - QUANTILE) * len(samples) + 1e-9)
    coefficient[0] = np.ceil(coefficient[0] + max(0.0, float(short_ns[len(samples) - 1 - allowed])))
    return coefficient


def predicted_ns(samples: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
    """Return (S,) f64: what a profile's coefficients (7,) say that samples (S,7) take; their last column is not read."""
    return coefficient[0] + (samples[:, :-1] * coefficient[1:]).sum(1)


def _rounded_up(value: float) -> float:
    """Return value or up to 0.1 % more: four significant digits."""
    if value == 0.0:
        return 0.0
    digits = 3 - int(np.floor(np.log10(value)))
    rounded = round(value, digits)
    return rounded if rounded >= value else round(rounded + 10.0**-digits, digits)


def _faults(samples: np.ndarray) -> list[str]:
    """Return a sentence for everything that these samples cannot tell."""
    faults, varied = [], []
    low, high = np.percentile(samples, (_LOW, _HIGH), axis=0)
    for k, name in enumerate(COLUMNS):
        if high[k] <= low[k]:
            faults.append(f"no sample varies {name} (they are {high[k]:g}); {_ADVICE[name]}")
        elif high[k] < _SPREAD * low[k]:
            faults.append(
                f"{name} range only from {low[k]:g} to {high[k]:g}, less than {_SPREAD:g} times; {_ADVICE[name]}"
            )
        else:
            varied.append(k)
    if high[-1] - low[-1] < _MS_SPREAD * np.median(samples[:, -1]):
        faults.append(
            f"the times hardly vary ({low[-1]:g} to {high[-1]:g} ms): the frames may wait for the screen; "
            "measure the time of the GPU, or without vertical sync"
        )
    columns = samples[:, varied] / np.maximum(samples[:, varied].max(0), 1e-300)
    centred = columns - columns.mean(0)
    tied = []
    for i, k in enumerate(varied):
        others = np.delete(centred, i, axis=1)
        if not others.shape[1]:
            continue
        rest = centred[:, i] - others @ np.linalg.lstsq(others, centred[:, i], rcond=None)[0]
        if (rest * rest).sum() < _APART * (centred[:, i] * centred[:, i]).sum():
            tied.append(COLUMNS[k])
    if tied:
        advice = _ADVICE[tied[-1]]
        faults.append(f"{', '.join(tied)} rise and fall together, so their costs cannot be told apart; {advice}")
    return faults
