"""`farfield layers`: prints what the metric places; refusals end with code 3 and say what to do."""

import itertools
import json
import math

import pytest
from farfield.cli.main import main

BOX = ["layers", "--cell", "box", "--t0", "100", "--depth", "60", "--w", "40", "--n", "23", "--m", "23", "--res", "256"]


def printed(capsys, *words):
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == "" and out.count("\n") == 1
    return json.loads(out)


def test_layers_adjoin_and_cover_the_depth(capsys):
    found = printed(capsys, *BOX)
    layers = found["layers"]
    assert found["count"] == len(layers) > 3
    assert found["count"] <= found["estimate"]
    assert layers[0]["near"] == 100 and layers[-1]["far"] == 160
    for a, b in itertools.pairwise(layers):
        assert a["near"] < a["t"] < a["far"] == b["near"]


def test_left_out_values_take_their_defaults(capsys):
    alpha = 2 * math.atan(40 / (2 * 256 * 100))
    given = ["--wy", "40", "--resy", "256", "--ny", "23", "--alpha", repr(alpha)]
    assert printed(capsys, *BOX) == printed(capsys, *BOX, *given)
    s = printed(capsys, *BOX)["s"]
    assert printed(capsys, *BOX, "--s", repr(s)) == printed(capsys, *BOX, "--s", "auto")


def test_a_point_as_view_cell_needs_one_layer_to_infinity(capsys):
    found = printed(capsys, "layers", "--cell", "box", "--t0", "10", "--depth", "inf", "--w", "5", "--res", "64")
    assert found == {"count": 1, "estimate": 1, "s": 0.0, "layers": [{"t": 20.0, "near": 10.0, "far": "inf"}]}


@pytest.mark.parametrize(
    "change, error",
    [
        ({"--t0": "0"}, "ObjectTouchesViewCell"), ({"--t0": "-3"}, "ObjectTouchesViewCell"), ({"--t0": "nan"}, "OutOfDomain"),
        ({"--t0": "inf"}, "OutOfDomain"), ({"--depth": "-1"}, "OutOfDomain"), ({"--depth": "nan"}, "OutOfDomain"),
        ({"--w": "0"}, "OutOfDomain"), ({"--w": "inf"}, "OutOfDomain"), ({"--res": "0.5"}, "OutOfDomain"),
        ({"--res": "nan"}, "OutOfDomain"), ({"--n": "-1"}, "OutOfDomain"), ({"--m": "inf"}, "OutOfDomain"),
        ({"--alpha": "0"}, "OutOfDomain"), ({"--alpha": "2"}, "OutOfDomain"), ({"--s": "24"}, "OutOfDomain"),
        ({"--s": "-1"}, "OutOfDomain"), ({"--cell": "shaft", "--beta": "180"}, "OutOfDomain"),
        ({"--cell": "shaft", "--beta": "360"}, "OutOfDomain"), ({"--t0": "1e-9"}, "OutOfDomain"),
    ],
)  # fmt: skip
def test_values_outside_the_domain_are_refused_by_name(change, error, capsys):
    words = dict(zip(BOX[1::2], BOX[2::2], strict=True)) | change
    assert main(["layers", *(f"{k}={v}" for k, v in words.items())]) == 3
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(f"{error}: ") and "Traceback" not in err


def test_words_that_are_no_numbers_are_bad_use(capsys):
    for words in (["--s", "x"], ["--t0", "far"], ["--cell", "sphere"]):
        with pytest.raises(SystemExit) as stopped:
            main([*BOX, *words])
        assert stopped.value.code == 2
