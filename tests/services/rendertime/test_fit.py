"""Fitted device profiles: what was put in comes out, 95 % lie below, and what samples cannot tell is named."""

import json
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from farfield.cli.main import main
from farfield.cli.place import load_settings
from farfield.errors import CalibrationError, SamplesDegenerate, SamplesInvalid, SamplesTooFew, SettingsInvalid
from farfield.rendertime.cost import build_cost_model
from farfield.rendertime.fit import FOLDS, MIN_SAMPLES, QUANTILE, fit_profile
from farfield.rendertime.profiles import PROFILES, find_profile
from farfield.rendertime.samples import COLUMNS, read_samples, samples_of
from farfield.settings import COEFFICIENTS, Fit, Settings, from_mapping, to_mapping
from naive.fit import TRUE, frames, loss
from scipy.optimize import linprog
from towns import town

FIT = Fit.__dataclass_fields__


def coefficients(profile):
    return np.array([getattr(profile, key) for key in COEFFICIENTS])


def noisy(share):
    return lambda rng, ns: ns * np.abs(rng.normal(0, share, len(ns)))


def test_exact_samples_give_their_coefficients_back():
    found = coefficients(fit_profile(frames(200)))
    assert (found >= TRUE * (1 - 1e-9)).all()
    np.testing.assert_allclose(found, TRUE, rtol=2e-3)


def test_noise_around_a_constant_shifts_only_the_constant():
    samples = frames(4000, seed=1, noise=lambda rng, ns: rng.exponential(2e5, len(ns)))
    found = coefficients(fit_profile(samples))
    off_ns = np.abs(found - TRUE)[1:] * samples[:, :-1].mean(0)
    assert (off_ns < 6e4).all(), "three standard errors of such a quantile"
    assert found[0] == pytest.approx(TRUE[0] + 2e5 * np.log(20), rel=0.06)


def test_a_profile_that_no_job_would_take_is_refused():
    samples = frames(200)
    samples[:, -1] *= 1e6  # nanoseconds
    with pytest.raises(SamplesDegenerate, match="are the times milliseconds"):
        fit_profile(samples)


@pytest.mark.parametrize("seed", range(12))
def test_at_most_a_twentieth_of_the_samples_lies_above_and_none_of_it_by_chance(seed):
    n = [100, 137, 400, 1999][seed % 4]
    samples = frames(n, seed=seed, noise=noisy([0.02, 0.2, 1.0][seed % 3]))
    profile = fit_profile(samples)
    found = coefficients(profile)
    over_ms = (found[0] + (samples[:, :-1] * found[1:]).sum(1)) / 1e6 - samples[:, -1]
    assert (over_ms < 0).sum() <= (1 - QUANTILE) * n
    assert (over_ms < 0).sum() >= (1 - QUANTILE) * n - 8, "more than its seven points of freedom below the quantile"
    assert (found >= 0).all()
    fit = profile.fit
    assert fit.samples == n and fit.quantile == QUANTILE
    assert fit.under_share == pytest.approx((over_ms < 0).mean())
    assert fit.mean_ms == pytest.approx(over_ms.mean(), abs=1e-5)
    assert fit.p95_ms == pytest.approx(np.quantile(over_ms, 0.95), abs=1e-5)
    assert fit.worst_ms == pytest.approx(-over_ms.min(), abs=1e-5)
    assert 0 <= fit.unseen_under_share < 0.05 + 3 * np.sqrt(0.05 * 0.95 / n) + 8 * FOLDS / n


def test_no_other_profile_loses_less():
    """Against the primal programme, written out with a variable for every sample's excess and lack."""
    samples = frames(150, seed=4, noise=noisy(0.3))
    drawn = np.concatenate([np.ones((150, 1)), samples[:, :-1]], axis=1)
    scale, eye = drawn.max(0), np.eye(150)
    primal = linprog(
        np.concatenate([np.zeros(7), np.full(150, QUANTILE), np.full(150, 1 - QUANTILE)]),
        A_eq=np.concatenate([drawn / scale, eye, -eye], axis=1), b_eq=samples[:, -1], method="highs",
    )  # fmt: skip
    ours = loss(samples, coefficients(fit_profile(samples)), QUANTILE)
    assert primal.fun * 1e6 <= ours * (1 + 1e-9)
    assert ours <= primal.fun * 1e6 * 1.02, "rounding up to four digits may cost so much"


def test_the_order_of_the_samples_changes_no_coefficient():
    samples = frames(300, seed=5, noise=noisy(0.2))
    shuffled = samples[np.random.default_rng(0).permutation(300)]
    np.testing.assert_allclose(coefficients(fit_profile(samples)), coefficients(fit_profile(shuffled)), rtol=1e-9)


def test_one_odd_frame_is_no_variation():
    samples = frames(200)
    samples[:, 1] = 5_000
    samples[7, 1] = 500_000
    with pytest.raises(SamplesDegenerate, match=r"no sample varies triangles \(they are 5000\)"):
        fit_profile(samples)


def together(samples):
    samples[:, 5] = 100 * samples[:, 3] + 7
    return samples


def waiting(samples):
    samples[:, 6] = 16.67 + 0.01 * np.sin(np.arange(len(samples)))
    return samples


def narrow(samples):
    samples[:, 0] = 1000 + samples[:, 0] / 10
    return samples


def faster_with_more(samples):
    samples[:, 6] = 30 - 4 * (samples[:, :6] / samples[:, :6].max(0)).sum(1)
    return samples


@pytest.mark.parametrize(
    ("spoil", "kind", "words"),
    [
        (lambda s: s[: MIN_SAMPLES - 1], SamplesTooFew, "99 samples are too few"),
        (lambda s: s * np.array([1, 1, 0, 1, 1, 1, 1]), SamplesDegenerate, "no sample varies pixels.*near objects"),
        (lambda s: s * np.array([0, 1, 1, 0, 1, 1, 1]), SamplesDegenerate, "varies calls.*; no sample varies impostors"),
        (narrow, SamplesDegenerate, "calls range only from .* less than 2 times"),
        (together, SamplesDegenerate, "impostors, impostor_pixels rise and fall together"),
        (waiting, SamplesDegenerate, "hardly vary .* wait for the screen"),
        (faster_with_more, SamplesDegenerate, "no frame takes longer where it draws more"),
        (lambda s: np.repeat(s[:1], 200, axis=0), SamplesDegenerate, "calls.*triangles.*pixels.*times hardly vary"),
    ],
)  # fmt: skip
def test_samples_that_cannot_tell_are_refused_with_what_is_missing(spoil, kind, words):
    with pytest.raises(kind, match=words) as refused:
        fit_profile(spoil(frames(200, seed=2)))
    assert isinstance(refused.value, CalibrationError) and refused.value.advice


def rows(samples):
    return [dict(zip((*COLUMNS, "ms"), row)) for row in samples.tolist()]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"triangles": -1}, "sample 3: triangles is -1"),
        ({"ms": float("nan")}, "sample 3: ms is nan"),
        ({"ms": 0}, "sample 3: ms is 0"),
        ({"pixels": float("inf")}, "sample 3: pixels is inf"),
        ({"pixels": "many"}, "sample 3: pixels is no number: 'many'"),
        ({"calls": None}, "sample 3 has no calls"),
        ({"calls": True}, "sample 3 has no calls"),
        ({"calls": 10**400}, "sample 3: calls is no number"),
    ],
)
def test_a_sample_that_nothing_can_measure_is_refused_with_its_row(change, words):
    given = rows(frames(10))
    given[2] |= change
    with pytest.raises(SamplesInvalid, match=words):
        samples_of(given)


@pytest.mark.parametrize("given", [None, {"calls": 1}, "text", [3], [[1, 2]], [{}] * 20_001])
def test_what_is_no_list_of_samples_is_refused(given):
    with pytest.raises(SamplesInvalid):
        samples_of(given)


def test_csv_and_json_are_the_same_samples(tmp_path):
    samples = frames(20)
    table = ",".join(("ms", "view", *COLUMNS[::-1])) + "\n"
    table += "".join(f"{r[-1]!r},{i},{','.join(map(repr, r[-2::-1]))}\n" for i, r in enumerate(samples.tolist()))
    (tmp_path / "a.csv").write_text(table)
    (tmp_path / "a.json").write_text(json.dumps(rows(samples)))
    (tmp_path / "b.json").write_text(json.dumps({"device": "here", "samples": rows(samples)}))
    for name in ("a.csv", "a.json", "b.json"):
        np.testing.assert_array_equal(read_samples(tmp_path / name), samples)
    for name, content in (("c.csv", b"\xff\xfe\x00"), ("d.json", b"[" * 100_000), ("e.csv", b""), ("f.json", b"{}")):
        (tmp_path / name).write_bytes(content)
        if name != "e.csv":
            with pytest.raises(SamplesInvalid):
                read_samples(tmp_path / name)
    assert read_samples(tmp_path / "e.csv").shape == (0, 7)
    with pytest.raises(SamplesInvalid, match="cannot be read"):
        read_samples(tmp_path / "none.csv")


def test_calibrate_writes_a_profile_that_place_takes(tmp_path, capsys):
    (tmp_path / "here.json").write_text(json.dumps(rows(frames(300, noise=noisy(0.1)))))
    out = tmp_path / "here.toml"
    assert main(["calibrate", str(tmp_path / "here.json"), "--name", "Büro 2", "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    settings = load_settings(None, "20 ms", str(out))
    assert settings.device == said["device"] == "Büro 2"
    assert to_mapping(settings)["device_profile"] == said["device_profile"]
    assert from_mapping(tomllib.loads(out.read_text())) == replace(settings, budget="16 ms")
    assert settings.device_profile.fit.samples == 300
    model = build_cost_model(town(9), settings=settings)
    assert model.per_call == settings.device_profile.per_call_ns and model.per_frame > 1_000_000
    assert main(["calibrate", str(tmp_path / "here.json")]) == 0
    assert "took longer than predicted" in capsys.readouterr().out
    assert load_settings(out, None, "phone").device_profile is None


def test_calibrate_refuses_by_name(tmp_path, capsys):
    (tmp_path / "few.json").write_text(json.dumps(rows(frames(30))))
    assert main(["calibrate", str(tmp_path / "few.json")]) == 3
    assert "SamplesTooFew: 30 samples" in capsys.readouterr().err
    assert main(["calibrate", str(tmp_path / "few.json"), "--name", "phone"]) == 2
    (tmp_path / "no.toml").write_text('device = "phone"\n')
    with pytest.raises(SettingsInvalid, match="no table device_profile"):
        load_settings(None, None, str(tmp_path / "no.toml"))


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({}, "device_profile.per_frame_ns: is missing"),
        (dict.fromkeys(COEFFICIENTS, 1) | {"per_call_ns": -1}, "device_profile.per_call_ns"),
        (dict.fromkeys(COEFFICIENTS, 1) | {"per_pixel_ns": float("nan")}, "device_profile.per_pixel_ns"),
        (dict.fromkeys(COEFFICIENTS, 1) | {"per_frame_ns": 1.5}, "device_profile.per_frame_ns"),
        (dict.fromkeys(COEFFICIENTS, 1) | {"fit": {"samples": 3}}, "device_profile.fit.quantile: is missing"),
        (dict.fromkeys(COEFFICIENTS, 1) | {"fit": dict.fromkeys(FIT, 0.5) | {"samples": 10**4000}}, "fit.samples"),
    ],
)
def test_a_profile_in_settings_is_checked(table, key):
    with pytest.raises(SettingsInvalid, match=key):
        from_mapping({"device_profile": table})


def test_presets_are_ordered_from_fast_to_slow_and_named():
    order = [coefficients(PROFILES[name]) for name in ("workstation", "reference", "laptop", "phone")]
    assert all((a <= b).all() for a, b in pairwise(order))
    assert all(p.fit is None for p in PROFILES.values())
    with pytest.raises(SettingsInvalid, match="laptop, phone, reference, workstation"):
        find_profile(Settings(device="toaster"))
