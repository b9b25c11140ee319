"""`farfield place` at the edges: what it refuses, what it leaves behind, and what it never deletes."""

import json
import os
import pickle
import signal
import subprocess
import sys
import time

import farfield.errors as errors
import pytest
from farfield.cli.main import main
from farfield.errors import FarfieldError
from levels import box_level

SETTINGS = "[view_space]\nboxes = [[[40, 0, 0], [42, 1, 2]]]\ncell_m = 2\n[camera]\nwidth = 64\nheight = 36\n"
SETTINGS += '[visibility]\nmode = "off"\n'


@pytest.fixture
def level(tmp_path):
    path = tmp_path / "scene.glb"
    path.write_bytes(box_level().glb())
    (tmp_path / "settings.toml").write_text(SETTINGS)
    return path


def place(level, out, *more):
    return main(["place", str(level), "--out", str(out), "--settings", str(level.parent / "settings.toml"),
                 "--workers", "1", "--json", *more])  # fmt: skip


@pytest.mark.parametrize("name", sorted(n for n, c in vars(errors).items() if isinstance(c, type)))
def test_an_error_crosses_a_process_border_with_its_facts(name):
    kind = getattr(errors, name)
    if not issubclass(kind, FarfieldError):
        return
    own = getattr(kind.__init__, "__code__", None)  # its own or one of a named error above it
    count = own.co_argcount - 1 if own else 1
    error = kind(*range(count)) if count > 1 else kind("what")
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind and str(back) == str(error) and vars(back) == vars(error)


def test_a_setting_that_only_a_worker_refuses_is_still_bad_use(level, tmp_path, capsys):
    assert place(level, tmp_path / "out", "--budget", "0.5 ms") == 2
    out, err = capsys.readouterr()
    assert not out and "SettingsInvalid: budget" in err and "Traceback" not in err
    assert not list((tmp_path / "out").iterdir())


def test_a_level_within_budget_leaves_three_outputs_and_one_document(level, tmp_path, capsys):
    for _ in range(2):  # the second run replaces the first
        assert place(level, tmp_path / "out") == 0
        assert json.loads(capsys.readouterr().out)["verdict"] == "valid"
        assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
            "base.ffc",
            "placement",
            "report.json",
            "scene.glb",
        ]


def test_the_scene_is_not_replaced_by_the_output_nor_any_folder_deleted(level, tmp_path):
    before = level.read_bytes()
    assert place(level, tmp_path) == 2  # its scene.glb would be the output's
    (tmp_path / "mine" / "work").mkdir(parents=True)
    (tmp_path / "mine" / "work" / "notes").write_text("keep")
    (tmp_path / "mine" / "placement").mkdir()
    assert place(level, tmp_path / "mine") == 2
    assert level.read_bytes() == before
    (tmp_path / "mine" / "placement").rmdir()
    assert place(level, tmp_path / "mine") == 0
    assert (tmp_path / "mine" / "work" / "notes").read_text() == "keep"


@pytest.mark.parametrize("out", ["settings.toml", "settings.toml/below"])
def test_an_output_folder_that_cannot_be_is_bad_use(level, tmp_path, out):
    assert place(level, tmp_path / out) == 2


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 100_000, "[view_space]\ncell_m = 1e-9", "[view_space]\ncell_m = 1e-300"]
)
def test_settings_without_end_are_refused(level, tmp_path, text):
    (tmp_path / "settings.toml").write_text(text)
    assert place(level, tmp_path / "out") == 2


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_job_leaves_no_process_running(level, tmp_path, how):
    command = [
        sys.executable,
        "-m",
        "farfield.cli.main",
        "place",
        str(level),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "1",
    ]
    job = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        children = _until(lambda: _children(job.pid) if list(tmp_path.glob("out/.work-*")) else None)
        job.send_signal(how)
        job.wait(30)
    finally:
        job.kill()
    _until(lambda: not any(os.path.exists(f"/proc/{pid}") and _state(pid) != "Z" for pid in children))
    if how == signal.SIGTERM:
        assert not list((tmp_path / "out").iterdir())


def _until(condition):
    end = time.monotonic() + 30
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.05)
    raise AssertionError("waited for half a minute")


def _children(pid):
    return [int(p) for p in open(f"/proc/{pid}/task/{pid}/children").read().split()]


def _state(pid):
    try:
        return open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()[0]
    except OSError:
        return "Z"


def test_a_damaged_report_is_refused_and_nothing_of_it_shown(level, tmp_path, capsys):
    assert place(level, tmp_path / "out") == 0
    path = tmp_path / "out" / "report.json"
    whole = json.loads(path.read_text())
    for damage in ({"verdict": "x"}, {"stages": 5}, {"version": "x"}, {"bytes": None}, {"hopeless": "x"}):
        path.write_text(json.dumps({**whole, **damage}))
        capsys.readouterr()
        assert main(["report", str(tmp_path / "out")]) == 3
        out, err = capsys.readouterr()
        assert not out and "ColumnsAltered: report.json" in err
