"""All of `farfield stability` as JSON values: formulas, predicates, extreme cases, relations, and what they were tried on."""

import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from farfield.stability.extremes import CASES, try_case
from farfield.stability.formulas import FORMULAS
from farfield.stability.predicates import PREDICATES
from farfield.stability.relations import check_relations
from farfield.stability.trial import worst

TRIES, PREDICATE_TRIES, RELATION_OBJECTS = 5000, 2000, 70
SHORT_TRIES, SHORT_PREDICATE_TRIES, SHORT_RELATION_OBJECTS = 60, 25, 30

Tell = Callable[[str], None]


def _formulas(tries: int, seed: int, tell: Tell) -> list[dict[str, Any]]:
    rows = []
    for k, formula in enumerate(FORMULAS):
        tell(f"formula {formula.name}")
        double, single = (
            worst(formula, tries=tries, seed=seed + 2 * k + is_single, single=bool(is_single)) for is_single in (0, 1)
        )
        rows.append({
            "name": formula.name, "equation": formula.equation, "domain": formula.domain, "limit": formula.limit,
            "float64": asdict(double), "float32": asdict(single),
            "holds": double.error <= formula.limit and double.not_a_number == 0,
        })  # fmt: skip
    return rows


def _predicates(tries: int, seed: int, tell: Tell) -> list[dict[str, Any]]:
    rows = []
    for predicate in PREDICATES:
        tell(f"predicate {predicate.__name__}")
        decided = predicate(tries, seed)
        rows.append({**asdict(decided), "holds": decided.error <= decided.limit and decided.forbidden == 0})
    return rows


def _cases(short: bool, tell: Tell) -> list[dict[str, Any]]:
    rows = []
    if not short:  # the limit is on what a case takes, not on compiling the kernels for the first of them
        tell("compiling")
        try_case(next(case for case in CASES if case.level is not None and case.error is None))
    for case in CASES:
        if case.short or not short:
            tell(f"case {case.name}")
            outcome = try_case(case)
            rows.append({**asdict(outcome), "holds": not outcome.wrong})
    return rows


def _relations(n_objects: int, tell: Tell) -> list[dict[str, Any]]:
    tell("relations")
    return [{**asdict(r), "holds": not r.differs} for r in check_relations(n_objects)]


def build_stability(*, short: bool = False, seed: int = 0, tell: Tell = lambda text: None) -> dict[str, Any]:
    """Return the report. `holds` of every row and of all says whether it is as it must be.

    short  fewer inputs, the quick cases, fewer objects: seconds
    tell   called with what is tried next
    Raises ImportError where mpmath (the extra `exact`) is missing.
    """
    import mpmath  # noqa: F401  before anything is tried

    found: dict[str, Any] = {
        "formulas": _formulas(SHORT_TRIES if short else TRIES, seed, tell),
        "predicates": _predicates(SHORT_PREDICATE_TRIES if short else PREDICATE_TRIES, seed, tell),
        "cases": _cases(short, tell),
        "relations": _relations(SHORT_RELATION_OBJECTS if short else RELATION_OBJECTS, tell),
    }
    return {
        **found, "holds": all(row["holds"] for rows in found.values() for row in rows), "seed": seed, "short": short,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "software": {name: version(name) for name in ("farfield", "numpy", "numba", "mpmath")},
        "command": "farfield stability" + (" --short" if short else "") + (f" --seed {seed}" if seed else ""),
    }  # fmt: skip
