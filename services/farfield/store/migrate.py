"""Brings the tables to a version, while the service runs.

Rule        Expand, then contract (docs/deployment.md): what a release adds, the release before it does not notice.
PostgreSQL  Each migration is a transaction of its own. One that waits for a lock makes everybody behind it wait, too: after
            LOCK_MS it gives up, lets them pass, and comes again. Two that start at once: the second waits.
SQLite      One transaction for all, without the enforcement of foreign keys: SQLite alters a table by copying it and
            dropping the old one, and a drop would delete the rows that point to it. They are checked before the commit.
"""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import alembic.command
import alembic.config
import sqlalchemy as sa

from farfield.errors import ServiceError

log = logging.getLogger(__name__)

LOCK_MS = 2_000
PATIENCE_S = 600.0
_ONE_AT_A_TIME = 0x66617266  # our number among the advisory locks of the database
_BUSY = ("55P03", "40P01")  # lock_not_available, deadlock_detected


def migrate(engine: sa.Engine, folder: Path, *, revision: str = "head", patience_s: float = PATIENCE_S) -> None:
    """Upgrade the tables to `revision` with the migrations in `folder`. Safe to repeat, and to run twice at once.

    Raises ServiceError where the tables were too busy for `patience_s`.
    """
    config = alembic.config.Config(str(folder / "alembic.ini"))
    end, pause_s = time.monotonic() + patience_s, 0.1
    while True:
        try:
            with prepared(engine) as connection:
                config.attributes["connection"] = connection
                alembic.command.upgrade(config, revision)
            return
        except sa.exc.DBAPIError as error:
            if getattr(error.orig, "sqlstate", None) not in _BUSY:
                raise
            if time.monotonic() > end:
                raise ServiceError(
                    f"the tables were in use for {patience_s:.0f} s: migrate at a calmer time"
                ) from error
            log.info("a table is in use: the migration comes again in %.1f s", pause_s)
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, 5.0)


@contextmanager
def prepared(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A connection of its own that may alter tables while others work."""
    with engine.connect() as connection:
        if connection.dialect.name == "sqlite":
            with _without_foreign_keys(connection), connection.begin():
                yield connection
                broken = connection.exec_driver_sql("PRAGMA foreign_key_check").fetchall()
                assert not broken, broken[:5]
            return
        connection.detach()  # these settings are for nobody else
        connection.exec_driver_sql(f"SET SESSION lock_timeout = {LOCK_MS}")
        connection.exec_driver_sql(f"SELECT pg_advisory_lock({_ONE_AT_A_TIME})")
        connection.commit()
        yield connection
        connection.commit()


@contextmanager
def _without_foreign_keys(connection: sa.Connection) -> Iterator[None]:
    raw = connection.connection.driver_connection
    assert raw is not None
    raw.execute("PRAGMA foreign_keys = OFF")  # nothing within a transaction
    try:
        yield
    finally:
        raw.execute("PRAGMA foreign_keys = ON")
