"""Benchmark rows: what is kept is read again, and ratios are to the golden run and to the bound, whatever the machine."""

from benchmarks.measure import Machine, Row, as_csv, as_page, finished, nbytes, read_golden, read_rows
from towns import town

SLOW, FAST = Machine(copy_bytes_s=1e9, sort_s=0.02), Machine(copy_bytes_s=4e9, sort_s=0.01)
ROW = Row(stage="scene", work="read", input="a, b", seconds=0.5, rate=2.0, unit="/s", least_bytes=10**6)


def test_a_row_is_held_against_the_golden_run_in_units_of_the_machine():
    then = finished(ROW, SLOW, {})
    assert then.times_before is None and then.bound_s == 1e-3
    golden = read_golden(as_csv([then], cores=2))
    assert finished(ROW, SLOW, golden).times_before == 1.0
    assert finished(ROW, FAST, golden).times_before == 0.5  # a machine twice as fast should have taken half
    other = Row(stage="scene", work="write", input="", seconds=1.0, rate=1.0, unit="/s")
    assert finished(other, FAST, golden).times_before is None


def test_rows_are_read_as_they_were_kept():
    rows = [
        finished(ROW, SLOW, {}),
        Row(stage="bake", work="x", input="", seconds=2.0, rate=3.0, unit="texels/s", exponent=1.5),
    ]
    again = read_rows(as_csv(rows, cores=2))
    assert again == rows
    page = as_page(rows, SLOW, command="make bench", where="here")
    assert "1MB moved" in page and page.count("\n| ") == 2 + len(rows)


def test_bytes_are_those_of_the_arrays():
    scene = town(4)
    assert nbytes(scene.position, scene.index) == scene.position.nbytes + scene.index.nbytes
    assert nbytes(scene) > nbytes(scene.position, scene.index)
