"""Dashboard and alerts name only metrics that are exported, and every alert has its runbook."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from farfield.store import workers
from farfield.store.artifacts import LocalArtifacts
from farfield.store.counters import Counts, totals
from farfield.store.engine import open_engine
from farfield.store.workers import Telling
from farfield_api.cluster_metrics import ClusterMetrics
from farfield_api.observe import HttpMetrics
from farfield_api.readiness import Readiness
from farfield_workers.serve import migrate
from prometheus_client import CollectorRegistry

ROOT = Path(__file__).parents[2]
MONITORING = ROOT / "infra" / "monitoring"
SUFFIXES = {"counter": ("_total",), "gauge": ("",), "histogram": ("_bucket", "_sum", "_count")}


def _series(url, folder):
    """Return the names of all series that an API process with this database answers with."""
    engine = open_engine(url)
    migrate(engine, ROOT / "migrations")
    workers.tell(
        engine, Telling(name="a", host="a", queues=("cpu", "gl"), capability={}, shard_id="0" * 32, stage="bake")
    )
    workers.tell(engine, Telling(name="b", host="a", queues=("optimizer",), capability={}), stopped=True)
    assert workers.served_queues(engine) == {"cpu": 1, "optimizer": 0, "gl": 1}
    counts = Counts()
    counts.observe("shard_seconds", 2.0, stage="bake")
    counts.flush(engine)
    counts.observe("shard_seconds", 2.0, stage="bake")
    counts.flush(engine)
    assert totals(engine)["shard_seconds_sum", "stage=bake"] == 4.0
    artifacts, registry = LocalArtifacts(folder / "artifacts"), CollectorRegistry()
    readiness = Readiness(engine, artifacts, bool, ROOT / "migrations")
    registry.register(ClusterMetrics(engine, artifacts, readiness))
    HttpMetrics(registry)
    names = {f.name + suffix for f in registry.collect() for suffix in SUFFIXES[f.type]}
    assert all(text == "ok" for name, text in readiness.ask().checks.items() if name != "workers")
    workers.end(engine, None)
    assert {w["state"] for w in workers.listed(engine)} == {"stopped"}
    engine.dispose()
    return names


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The names of all series that an API process answers with."""
    folder = tmp_path_factory.mktemp("exported")
    return _series(f"sqlite:///{folder / 'farfield.sqlite'}", folder)


def test_the_same_is_told_on_postgresql(exported, postgres, tmp_path):
    assert _series(postgres.new(), tmp_path) == exported


def _named(text):
    return set(re.findall(r"farfield_[a-z_]+", text))


def _rules():
    groups = yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def test_the_dashboard_names_exported_metrics_only_and_leaves_none_out(exported):
    panels = json.loads((MONITORING / "dashboard.json").read_text())["panels"]
    named = set().union(*(_named(target["expr"]) for panel in panels for target in panel.get("targets", [])))
    assert named - exported == set()
    families = {re.sub("_(bucket|sum|count)$", "", name) for name in exported}
    shown = {re.sub("_(bucket|sum|count)$", "", name) for name in named}
    # Python tells of created_at stamps for its own counters: nobody looks at those.
    assert {name for name in families - shown if not name.endswith("_created")} == set()
    places = [tuple(panel["gridPos"][key] for key in ("x", "y")) for panel in panels]
    assert len(set(places)) == len(places)


def test_every_alert_names_exported_metrics_and_its_runbook(exported):
    headings = re.findall(r"^#+ (.+)$", (ROOT / "docs/operations.md").read_text(), flags=re.M)
    anchors = {re.sub(r"[^a-z0-9 -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    assert len(_rules()) >= 10
    for rule in _rules():
        assert set(rule) <= {"alert", "expr", "for", "labels", "annotations"}
        assert _named(rule["expr"]) <= exported, rule["alert"]
        assert _named(rule["expr"])
        assert rule["labels"]["severity"] in ("page", "ticket")
        page, _, anchor = rule["annotations"]["runbook"].partition("#")
        assert page == "docs/operations.md"
        assert anchor in anchors, anchor


def test_what_autoscaling_relies_on_is_exported(exported):
    assert "farfield_queue_depth" in exported


def test_promtool_accepts_the_rules_and_they_fire_when_they_should():
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool is not installed: sh infra/setup/system.sh prometheus")
    for words in (
        ["check", "rules", str(MONITORING / "alerts.yml")],
        ["check", "config", "--syntax-only", str(MONITORING / "prometheus.yml")],
        ["test", "rules", str(Path(__file__).with_name("alerts.test.yml"))],
    ):
        checked = subprocess.run([promtool, *words], capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stdout + checked.stderr
