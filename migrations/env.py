"""Runs the migrations: `alembic -c migrations/alembic.ini upgrade head`, or from a caller with its own connection."""

import os

from alembic import context
from farfield.store.engine import open_engine
from farfield.store.migrate import prepared
from farfield.store.tables import metadata


def _migrate(connection):
    # SQLite cannot alter a column: alembic copies the table instead ("batch").
    batch = connection.dialect.name == "sqlite"
    context.configure(
        connection=connection, target_metadata=metadata, render_as_batch=batch, compare_type=True,
        transaction_per_migration=True,
    )  # fmt: skip
    with context.begin_transaction():
        context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:
    _migrate(given)
else:
    with prepared(open_engine(os.environ["FARFIELD_DATABASE_URL"])) as own:
        _migrate(own)
