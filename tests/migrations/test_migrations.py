"""The migrations make exactly the tables that the code knows."""

from pathlib import Path

import alembic.command
import alembic.config
from farfield.store.engine import open_engine
from farfield.store.tables import metadata
from farfield_workers.serve import migrate

FOLDER = Path(__file__).parents[2] / "migrations"


def _config(connection):
    config = alembic.config.Config(str(FOLDER / "alembic.ini"))
    config.attributes["connection"] = connection
    return config


def test_upgrade_makes_what_the_tables_say(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path / 'a.sqlite'}")
    migrate(engine, FOLDER)
    migrate(engine, FOLDER)  # nothing more to do
    with engine.begin() as connection:
        alembic.command.check(_config(connection))


def test_downgrade_leaves_nothing(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path / 'a.sqlite'}")
    migrate(engine, FOLDER)
    with engine.begin() as connection:
        alembic.command.downgrade(_config(connection), "base")
        assert set(connection.dialect.get_table_names(connection)) <= {"alembic_version"}


def test_every_table_a_client_can_name_rows_of_has_a_tenant():
    shared = {
        "tenant",
        "artifact",
        "worker",
        "counter",
    }  # blobs are shared by digest, below the API; the rest is the operator's
    assert all("tenant_id" in table.c for name, table in metadata.tables.items() if name not in shared)
