"""Tables are altered while workers claim and clients write: nobody fails, nothing is lost, nobody waits for the end."""

import json
import logging
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.script import ScriptDirectory
from farfield.errors import ServiceError
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine, read, write
from farfield.store.migrate import migrate
from farfield.store.tables import job, shard

TESTS = Path(__file__).parents[1]
FOLDER = TESTS.parent / "migrations"
NEXT = '''
"""What an expanding migration does: columns, an index, a table, values for the rows that are there."""
import sqlalchemy as sa
from alembic import op

revision, down_revision = "next", "{head}"


def upgrade():
    op.add_column("shard", sa.Column("grown", sa.Integer(), nullable=True))
    op.add_column("job", sa.Column("grown", sa.Integer(), server_default="7", nullable=False))
    op.add_column("event", sa.Column("grown", sa.String(20), nullable=True))
    op.create_index("ix_shard_grown", "shard", ["grown"])
    op.create_table("grown", sa.Column("id", sa.Integer(), primary_key=True))
    op.execute(sa.text("UPDATE shard SET grown = 1"))
    with op.batch_alter_table("stage") as stage:  # SQLite copies the table
        stage.alter_column("name", existing_type=sa.String(40), type_=sa.String(80))
'''


def _head():
    return ScriptDirectory(str(FOLDER)).get_current_head()


class Writer(threading.Thread):
    """Does one small transaction after the other, and counts them."""

    def __init__(self, url, statement):
        super().__init__(daemon=True)
        self.engine, self.statement = open_engine(url), statement
        self.number, self.ended, self.error = 0, threading.Event(), None

    def run(self):
        try:
            while not self.ended.wait(0.002):
                with write(self.engine) as tx:
                    tx.execute(sa.text(self.statement), {"n": self.number})
                self.number += 1
        except Exception as error:
            self.error = error

    def stop(self):
        self.ended.set()
        self.join(60)
        self.engine.dispose()
        if self.error is not None:
            raise self.error
        return self.number


def test_workers_and_clients_notice_nothing_of_the_next_migration(engine, empty, tmp_path):
    migrate(engine, FOLDER)
    after = tmp_path / "migrations"
    shutil.copytree(FOLDER, after, ignore=shutil.ignore_patterns("__pycache__"))
    (after / "versions" / "next.py").write_text(NEXT.replace("{head}", _head()))
    tenant_id = tenants.create_tenant(engine, "toy")
    artifacts = LocalArtifacts(tmp_path / "artifacts")
    wish = json.dumps({"seconds": 0.15, "shards": 6}).encode()
    digest, shown = artifacts.put(wish), artifacts.put(b"{}")
    scenes.add(engine, tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(wish), summary={},
               inspect_digest=shown, inspect_bytes=2)  # fmt: skip

    def submit(seed):
        return jobs.create(engine, tenant_id, name="toy", scene_digest=digest, idempotency_key=None,
                           settings=to_mapping(Settings(seed=seed)), stages=list(Stage))[0]  # fmt: skip

    submit(0)
    racers = [
        subprocess.Popen([sys.executable, str(TESTS / "racing.py"), empty, str(artifacts.root), str(seed)],
                         stderr=subprocess.PIPE, text=True)
        for seed in range(2)
    ]  # fmt: skip
    writer = Writer(empty, "UPDATE tenant SET name = 'toy ' || :n")
    writer.start()
    end = time.monotonic() + 60
    while time.monotonic() < end:  # until they work
        with read(engine) as tx:
            if tx.scalar(sa.select(sa.func.count()).where(shard.c.state == "done")):
                break
        time.sleep(0.05)
    before = writer.number
    migrate(engine, after)
    assert sa.inspect(engine).has_table("grown")
    submit(1)
    told = [racer.communicate(timeout=100)[1] for racer in racers]
    assert [racer.returncode for racer in racers] == [0, 0], told
    number = writer.stop()
    assert number > before > 0
    with read(engine) as tx:
        assert tx.scalar(sa.text("SELECT name FROM tenant WHERE name LIKE 'toy %'")) == f"toy {number - 1}"
        assert set(tx.scalars(sa.select(shard.c.attempt))) == {1}
        assert set(tx.scalars(sa.select(job.c.state))) == {"done"}
        assert tx.scalar(sa.text("SELECT count(*) FROM job WHERE grown = 7")) == 2


def _until(happened):
    end = time.monotonic() + 20  # well within the 30 s after which anybody gives up waiting for a lock
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_the_newest_migration_lets_writers_pass(engine, empty, caplog):
    """From the version before, with a transaction in the way that holds every table until all writers have passed."""
    caplog.set_level(logging.INFO, "farfield.store.migrate")
    before = ScriptDirectory(str(FOLDER)).get_revision(_head()).down_revision
    migrate(engine, FOLDER, revision=before)
    with write(engine) as tx:
        tx.execute(sa.text("INSERT INTO tenant (id, name, created_at) VALUES ('t', 'default', 1)"))
    writers = [
        Writer(empty, "UPDATE tenant SET created_at = created_at + 1 WHERE id = 't'"),
        Writer(empty, "INSERT INTO artifact (digest, n_bytes, created_at) VALUES ('a' || :n, 1, 1)"),
    ]
    for writer in writers:
        writer.start()
    slow = open_engine(empty)
    with slow.connect() as in_the_way:
        for name in ("job", "shard", "stage", "tenant", "event"):
            in_the_way.execution_options(farfield_read=True).execute(sa.text(f"SELECT count(*) FROM {name}"))
        migrating = threading.Thread(target=migrate, args=(engine, FOLDER))
        migrating.start()
        if engine.dialect.name == "postgresql":  # SQLite's readers are in nobody's way, nor in that of a new table
            _until(lambda: "comes again" in caplog.text or not migrating.is_alive())
        reached = [writer.number for writer in writers]
        _until(lambda: all(w.number > n + 10 for w, n in zip(writers, reached, strict=True)))
        in_the_way.rollback()
    migrating.join(60)
    assert not migrating.is_alive()
    numbers = [writer.stop() for writer in writers]
    with read(engine) as tx:
        assert tx.scalar(sa.text("SELECT version_num FROM alembic_version")) == _head()
        assert tx.scalar(sa.text("SELECT created_at FROM tenant WHERE id = 't'")) == 1 + numbers[0]
        assert tx.scalar(sa.text("SELECT count(*) FROM artifact")) == numbers[1]
    slow.dispose()


def test_two_migrations_at_once_are_one(engine, empty):
    second = open_engine(empty)
    threads = [threading.Thread(target=migrate, args=(e, FOLDER)) for e in (engine, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    second.dispose()
    with read(engine) as tx:
        assert tx.scalars(sa.text("SELECT version_num FROM alembic_version")).all() == [_head()]


def test_a_table_that_stays_in_use_is_named_as_the_reason(postgres):
    engine = open_engine(postgres.new())
    migrate(engine, FOLDER, revision="0003")
    with engine.connect() as in_the_way:
        in_the_way.execute(sa.text("SELECT count(*) FROM shard"))
        with pytest.raises(ServiceError, match="in use"):
            migrate(engine, FOLDER, patience_s=0.0)
        in_the_way.rollback()
    migrate(engine, FOLDER)
    engine.dispose()
