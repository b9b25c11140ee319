"""The migrations make exactly the tables that the code knows, and keep what is in them."""

from pathlib import Path

import alembic.command
import alembic.config
import sqlalchemy as sa
from alembic.script import ScriptDirectory
from farfield.store.migrate import migrate, prepared
from farfield.store.tables import metadata

FOLDER = Path(__file__).parents[2] / "migrations"
OLDEST_KEPT = "0003"  # the tables of the first release


def _config(connection=None):
    config = alembic.config.Config(str(FOLDER / "alembic.ini"))
    config.attributes["connection"] = connection
    return config


def _downgrade(engine, revision):
    with prepared(engine) as connection:
        alembic.command.downgrade(_config(connection), revision)


def test_upgrade_makes_what_the_tables_say(engine):
    migrate(engine, FOLDER)
    migrate(engine, FOLDER)  # nothing more to do
    with engine.begin() as connection:
        alembic.command.check(_config(connection))


def test_downgrade_leaves_nothing(engine):
    migrate(engine, FOLDER)
    _downgrade(engine, "base")
    assert set(sa.inspect(engine).get_table_names()) <= {"alembic_version"}


def test_the_migrations_are_one_chain():
    script = ScriptDirectory.from_config(_config())
    assert len(script.get_heads()) == 1
    assert all(not isinstance(r.down_revision, tuple) for r in script.walk_revisions())


def test_rows_survive_the_way_up_and_down(engine):
    """SQLite alters a table by dropping its copy: with foreign keys enforced, a job's rows would go with it."""
    migrate(engine, FOLDER, revision=OLDEST_KEPT)
    d = "0" * 64
    rows = {
        "tenant": {"id": "t", "name": "default", "created_at": 1.0},
        "api_key": {"id": "k", "tenant_id": "t", "name": "k", "secret_digest": d, "scopes": "read", "created_at": 1.0},
        "artifact": {"digest": d, "n_bytes": 3_000_000_000, "created_at": 1.0},
        "scene": {"tenant_id": "t", "digest": d, "name": "s", "suffix": ".glb", "n_bytes": 1, "summary": {},
                  "inspect_digest": d, "created_at": 1.0},
        "device_profile": {"id": "d", "tenant_id": "t", "name": "d", "model": {}, "created_at": 1.0},
        "device_sample": {"tenant_id": "t", "device_profile_id": "d", "first": 0, "frames": [[1]], "created_at": 1.0},
        "webhook": {"id": "w", "tenant_id": "t", "url": "https://hook.example", "secret": "s", "created_at": 1.0},
        "job": {"id": "j", "tenant_id": "t", "name": "j", "scene_digest": d, "settings": {"seed": 1},
                "device_profile_id": "d", "webhook_id": "w", "request_digest": d, "state": "running", "event_seq": 1,
                "optimizer_token": 0, "created_at": 1.0},
        "stage": {"id": "g", "tenant_id": "t", "job_id": "j", "ordinal": 0, "name": "scene", "state": "running"},
        "shard": {"id": "h", "tenant_id": "t", "job_id": "j", "stage_id": "g", "kind": "run", "ordinal": 0,
                  "queue": "cpu", "params": "all", "state": "done", "attempt": 1, "cached": False, "artifact_digest": d,
                  "peak_bytes": 5_000_000_000},
        "event": {"tenant_id": "t", "job_id": "j", "seq": 1, "kind": "job", "data": {}, "created_at": 1.0},
    }  # fmt: skip
    with engine.begin() as connection:
        tables = sa.MetaData()
        tables.reflect(connection)
        for name, row in rows.items():
            connection.execute(sa.insert(tables.tables[name]).values(row))

    def missing():
        with engine.connect() as connection:
            return [name for name in rows if connection.scalar(sa.text(f"SELECT count(*) FROM {name}")) != 1]

    migrate(engine, FOLDER)
    assert missing() == []
    with engine.connect() as connection:
        counted = connection.execute(sa.text("SELECT n_shards, n_done, peak_bytes FROM stage")).one()
        assert tuple(counted) == (1, 1, 5_000_000_000)
    _downgrade(engine, OLDEST_KEPT)
    assert missing() == []
    migrate(engine, FOLDER)
    assert missing() == []


def test_every_table_a_client_can_name_rows_of_has_a_tenant():
    # Blobs, below the API; digests of cookies, which nobody can name; the rest is the operator's.
    shared = {"tenant", "artifact", "worker", "counter", "ended_session"}
    assert all("tenant_id" in table.c for name, table in metadata.tables.items() if name not in shared)
