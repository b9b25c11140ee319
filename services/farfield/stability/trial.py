"""One row of the table of formulas: a kernel against its twin in 50 digits, over a domain, in float64 and in float32.

Problem  By how much can the result of a formula be wrong, and for which input?
Method   Draw inputs (seeded), round them to the type, compute with the kernel as it stands and exactly from the rounded
         inputs. float32: the kernel's own source with the same operations in float32 (`in_float32`).
Error    |found - exact| / |exact|, divided by the condition of the formula there (at least 1): what its own inputs' last
         digits would do is not its fault. A threshold, where a spacing becomes infinite, is a pole. The undivided error
         is kept beside it. Infinite on one side of a threshold only counts as right where rounding decides on which.
"""

import math
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

U64, U32 = 2.0**-53, 2.0**-24
Arguments = tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Formula:
    """A kernel, its twin, and where both are tried. `draw` gets a unit of length: 1, or (float64 only) an extreme one."""

    name: str
    equation: str
    domain: str
    draw: Callable[[np.random.Generator, float], Arguments]
    kernel: Callable[..., float]
    exact: Callable[..., Any]
    condition: Callable[..., Any] = lambda *a: 1
    limit: float = 1e-12  # of the error in float64


@dataclass(frozen=True, slots=True, kw_only=True)
class Worst:
    """The largest errors of a formula in one type."""

    error: float  # over the condition
    at: str  # the input that gave it
    plain: float  # not divided
    plain_condition: float
    plain_at: str
    not_a_number: int
    tried: int


class _Math32:
    """The functions of `math` that kernels call, in float32."""

    sqrt, hypot, tan, cos, log1p, ceil = (
        staticmethod(f) for f in (np.sqrt, np.hypot, np.tan, np.cos, np.log1p, np.ceil)
    )


@cache
def in_float32(kernel: Any) -> Callable[..., Any]:
    """Return the kernel's source as a Python function whose mathematics stays in the type of its arguments."""
    source = kernel.py_func
    names = {name: source.__globals__.get(name) for name in source.__code__.co_names}
    inner = {name: in_float32(f) for name, f in names.items() if hasattr(f, "py_func")}
    scope = source.__globals__ | inner | {"math": _Math32}
    return types.FunctionType(source.__code__, scope, source.__name__, source.__defaults__)


def rounded(value: Any) -> Any:
    """Return a float or array in float32; anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value.astype(np.float32)
    return np.float32(value) if isinstance(value, float) else value


def as_double(value: Any) -> Any:
    """Return the same number in float64: exact."""
    if isinstance(value, np.ndarray):
        return value.astype(np.float64).tolist()
    return float(value) if isinstance(value, np.floating) else value


def worst(formula: Formula, *, tries: int, seed: int, single: bool) -> Worst:
    """Return the largest errors of a formula over `tries` inputs, in float32 if `single`, else in float64."""
    import mpmath as mp

    rng = np.random.default_rng(seed)
    units = (1.0,) if single else (1.0, 1.0, 1.0, 1e140, 1e-140, 1e75, 1e-75)
    error = plain = -1.0
    at = plain_at = ""
    plain_condition, broken = 1.0, 0
    with mp.workdps(700), np.errstate(all="ignore"):
        for _ in range(tries):
            inputs = formula.draw(rng, units[rng.integers(len(units))])
            if single:
                inputs = tuple(rounded(x) for x in inputs)
                found = float(in_float32(formula.kernel)(*inputs))
            else:
                found = float(formula.kernel(*inputs))
            numbers = tuple(as_double(x) for x in inputs)
            wanted, condition = formula.exact(*numbers), max(1, formula.condition(*numbers))
            broken += math.isnan(found)
            raw = _relative(found, wanted, condition, U32 if single else U64)
            scaled = float(raw / condition) if condition < mp.inf else 0.0
            if scaled > error or math.isnan(scaled):
                error, at = scaled, _said(inputs)
            if float(raw) > plain and condition < mp.inf:
                plain, plain_condition, plain_at = float(raw), float(condition), _said(inputs)
    return Worst(
        error=error, at=at, plain=plain, plain_condition=plain_condition, plain_at=plain_at, not_a_number=broken, tried=tries
    )  # fmt: skip


def _relative(found: float, wanted: Any, condition: Any, unit: float) -> Any:
    import mpmath as mp

    if math.isnan(found):
        return mp.inf
    if mp.isinf(wanted) or math.isinf(found):
        same = mp.isinf(wanted) == math.isinf(found)
        return mp.mpf(0) if same or condition > 1e-3 / unit else mp.inf
    if wanted == 0:
        return mp.mpf(0) if found == 0 else mp.inf
    return abs(mp.mpf(found) - wanted) / abs(wanted)


def _said(inputs: Sequence[Any]) -> str:
    """Return inputs as text from which the same numbers are read."""
    return ", ".join(np.array2string(x, separator=" ") if isinstance(x, np.ndarray) else str(x) for x in inputs)
