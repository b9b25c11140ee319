"""Settings: defaults, round trip, refusals with the key's name."""

import pytest
from farfield.errors import SettingsInvalid
from farfield.settings import Budget, Settings, from_mapping, parse_budget, to_mapping


@pytest.mark.parametrize(
    "text, budget",
    [
        ("16 ms", Budget("ns", 16_000_000)),
        ("300 calls", Budget("calls", 300)),
        ("200000 triangles", Budget("triangles", 200_000)),
        ("16.5ms", Budget("ns", 16_500_000)),
        ("16.67 ms", Budget("ns", 16_670_000)),
        ("8.3 ms", Budget("ns", 8_300_000)),
        ("1 call", Budget("calls", 1)),
        ("0 ms", Budget("ns", 0)),
    ],
)
def test_budgets_are_whole_numbers_of_their_unit(text, budget):
    assert parse_budget(text) == budget


@pytest.mark.parametrize(
    "text",
    ["", "16", "-1 ms", "1.5 calls", "nan ms", "1e3 ms", "16 s", "99999999999999999999 calls", "9" * 5000 + " ms"],
)
def test_other_budgets_are_refused(text):
    with pytest.raises(SettingsInvalid, match="budget"):
        parse_budget(text)


def test_settings_come_back_as_they_went():
    settings = from_mapping({"budget": "300 calls", "view_space": {"boxes": [[[0, 0, 0], [1, 2, 3]]], "cell_m": 4}})
    assert settings.view_space.boxes == (((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),)
    assert from_mapping(to_mapping(settings)) == settings
    assert from_mapping({}) == Settings()


@pytest.mark.parametrize(
    "values, key",
    [
        ({"nonsense": 1}, "nonsense"),
        ({"camera": {"fov_deg": 0}}, "camera.fov_deg"),
        ({"camera": {"width": 1.5}}, "camera.width"),
        ({"camera": 3}, "camera"),
        ({"seed": -1}, "seed"),
        ({"seed": True}, "seed"),
        ({"device": "x" * 256}, "device"),
        ({"scene": {"up": "x"}}, "scene.up"),
        ({"view_space": {"interval_deg": 10}}, "view_space.interval_deg"),
        ({"view_space": {"boxes": []}}, "view_space.boxes"),
        ({"view_space": {"boxes": [[[0, 0, 0], [1, -1, 1]]]}}, "view_space.boxes\\[0\\]"),
        ({"view_space": {"boxes": [[[0, 0], [1, 1]]]}}, "view_space.boxes"),
        ({"view_space": {"cell_m": float("inf")}}, "cell_m"),
        ({"quality": {"pixel_error": 0}}, "quality.pixel_error"),
        ({"placement": {"assignment": "best"}}, "placement.assignment"),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_key(values, key):
    with pytest.raises(SettingsInvalid, match=key):
        from_mapping(values)
