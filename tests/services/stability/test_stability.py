"""`farfield stability` holds in its short form, and says so where something does not."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from farfield.cli.main import main
from farfield.errors import SceneEmpty
from farfield.impostor import kernels
from farfield.impostor.metric import Layers
from farfield.placement.choose import choose
from farfield.stability import extremes, parts, predicates, relations, report
from farfield.stability.formulas import FORMULAS
from farfield.stability.level import street
from farfield.stability.trial import Formula, in_float32, worst

BY_NAME = {f.name: f for f in FORMULAS}


def test_the_short_form_holds_and_prints_one_document(capsys, monkeypatch):
    monkeypatch.setattr(report, "SHORT_TRIES", 25)
    assert main(["stability", "--short", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["holds"] and found["short"] and found["command"] == "farfield stability --short"
    assert {r["name"] for r in found["formulas"]} == set(BY_NAME)
    assert len(found["predicates"]) == 4 and len(found["relations"]) == 6
    assert len(found["cases"]) == sum(c.short for c in extremes.CASES) > 25
    assert all(r["float64"]["error"] <= 1e-12 and r["float64"]["not_a_number"] == 0 for r in found["formulas"])


def test_every_formula_of_the_kernels_is_in_the_table():
    """A formula that is added to the kernels is added to the table."""
    scalar = {n for n, f in vars(kernels).items() if hasattr(f, "py_func") and not n.startswith("_")}
    composed = {"steps", "stack", "cut_triangles"}  # of others in the table; of integers
    assert scalar - composed == set(BY_NAME)


def test_an_unstable_form_is_found_out():
    """The harmonic mean less its smaller number: all digits are gone where the gap is small."""
    subtracted = lambda t, gap, s: 2 * t * (t + gap) / (2 * t + gap) - t  # noqa: E731
    formula = replace(
        BY_NAME["border"], kernel=subtracted, draw=lambda rng, unit: (1.0, float(10 ** rng.uniform(-15, 6)), 0.0)
    )
    found = worst(formula, tries=200, seed=0, single=False)
    assert found.error > 1e-3
    inputs = [float(x) for x in found.at.split(", ")]  # told so that it can be tried again
    with mp.workdps(60):
        wanted = formula.exact(*inputs)
        assert float(abs(subtracted(*inputs) - wanted) / wanted) == pytest.approx(found.error)


def test_nan_is_counted():
    broken = Formula(name="x", equation="", domain="", draw=lambda rng, unit: (1.0,), kernel=lambda x: math.nan,
                     exact=lambda x: mp.mpf(x))  # fmt: skip
    found = worst(broken, tries=5, seed=0, single=False)
    assert found.not_a_number == 5 and math.isinf(found.error)


def test_float32_is_float32():
    spacing = in_float32(kernels.depth_near)
    with np.errstate(all="ignore"):
        found = spacing(*(np.float32(x) for x in (3.0, 0.5, 2.0, 0.01)))
    assert isinstance(found, np.float32)
    assert float(found) == pytest.approx(kernels.depth_near(3.0, 0.5, 2.0, 0.01), rel=1e-5)
    assert float(found) != kernels.depth_near(3.0, 0.5, 2.0, 0.01)


def test_a_predicate_that_errs_to_the_wrong_side_is_found_out(monkeypatch):
    narrow = predicates._frustum

    def narrower(*key):
        table, pad = narrow(*key)
        moved = table.copy()
        moved[:, :3] *= 0.9  # away from its own absolute values: the cone is narrower
        moved[:, 3:] *= 0.8
        return moved, -0.01 * (pad >= 0)

    monkeypatch.setattr(predicates, "_frustum", narrower)
    assert predicates.enclosing_frusta(60, 0).forbidden > 5


def test_a_wrong_shaft_test_is_found_out(monkeypatch):
    right = predicates.shaft_holds

    class Wider:
        py_func = right.py_func

        def __call__(self, cell, box):
            return right(np.array([*cell[:6], cell[6] * (1 + 1e-9), *cell[7:]], cell.dtype), box)

    monkeypatch.setattr(predicates, "shaft_holds", Wider())
    assert 1e-12 < predicates.cell_in_shaft(400, 0).error < 1e-8


def case(name):
    return next(c for c in extremes.CASES if c.name == name)


def test_a_case_that_ends_otherwise_is_wrong():
    refused = case("0 objects")
    assert extremes.try_case(refused).wrong == ""
    assert extremes.try_case(replace(refused, error="SceneNotFinite")).wrong == "expected SceneNotFinite"
    assert extremes.try_case(replace(refused, error=None)).wrong == "expected an answer"
    answered = case("budget above the scene's cost")
    assert extremes.try_case(replace(answered, error=SceneEmpty.__name__)).wrong == "expected SceneEmpty"
    assert "problem views" not in extremes.try_case(answered).wrong
    assert extremes.try_case(replace(answered, settings=extremes.CALLS)).wrong.startswith("problem views or impostors")
    assert extremes.try_case(replace(answered, limit_s=0.0)).wrong.startswith("took longer")
    assert extremes.try_case(replace(answered, level=lambda: 1 / 0)).wrong.startswith("ZeroDivisionError")


def test_layers_that_are_wrong_are_found_out(monkeypatch):
    setup = {n: s for n, s, _ in parts.SETUPS}["cell without depth"]
    good = parts.place_layers(setup)
    assert parts.layers_of(setup)[1] == "" and len(good.t) > 3

    def with_layers(**changes):
        made = Layers(**{k: getattr(good, k) for k in ("s", "estimate", "t", "near", "far")} | changes)
        monkeypatch.setattr(parts, "place_layers", lambda s: made)
        return parts.layers_of(setup)[1]

    assert "gap" in with_layers(t=np.delete(good.t, 1), near=np.delete(good.near, 1),
                                far=np.r_[good.near[2], np.delete(good.far, [0, 1])])  # fmt: skip
    assert "order" in with_layers(t=good.t[::-1].copy())
    assert "cover" in with_layers(near=good.near + 1)
    assert "estimated" in with_layers(estimate=1)


def test_a_greedy_that_stops_early_is_found_out(monkeypatch):
    assert parts.many_views(2000, n_candidates=50)[1] == ""

    class Half:
        def __init__(self, *a, **k):
            self.step = choose(*a, **k).step[:10]

    monkeypatch.setattr("farfield.placement.choose.choose", Half)
    assert "over their target" in parts.many_views(2000, n_candidates=50)[1]


def test_relations_name_what_differs(tmp_path):
    level = street(30)
    plain = relations._placed(level, tmp_path)
    other = relations._placed(street(30, seed=1), tmp_path)
    assert relations._all_stages(plain, plain) == ()
    assert "placement.bytes" in relations._all_stages(plain, other)
    moved = replace(level, box=level.box + np.array([0.5, 0, 0]))
    assert relations.permutation(moved, plain, tmp_path).differs
    assert relations.scaling(moved, plain, tmp_path).differs


def test_without_mpmath_it_says_what_to_install():
    code = "import sys; sys.modules['mpmath'] = None; from farfield.cli.main import main; sys.exit(main(['stability']))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 2 and "pip install" in ran.stderr and "Traceback" not in ran.stderr
