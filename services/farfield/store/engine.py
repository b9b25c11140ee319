"""One engine for SQLite and PostgreSQL; only the URL differs.

SQLite   WAL, busy_timeout, and BEGIN IMMEDIATE for every transaction that may write: a deferred BEGIN that upgrades
         later fails with "database is locked" whatever the timeout (76 % of them, with 8 processes).
PostgreSQL  psycopg 3, READ COMMITTED. Either side takes a silent peer for gone after GONE_S, and a transaction that
         stands idle for a minute ends: a host that is cut off holds no lock for long.
Time     `now()` is the database's clock: machines of a fleet disagree, leases must not.
"""

import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

BUSY_TIMEOUT_MS = 30_000
POOL = 5  # connections that a process keeps, and as many more while they are needed: see docs/deployment.md on sizing
GONE_S = 20  # after which a peer that acknowledges nothing is taken for gone
_POSTGRES_TCP = {
    "connect_timeout": 10, "tcp_user_timeout": GONE_S * 1000,
    "keepalives_idle": GONE_S // 2, "keepalives_interval": 5, "keepalives_count": 2,
}  # fmt: skip
_POSTGRES_SESSION = {
    "tcp_keepalives_idle": GONE_S // 2, "tcp_keepalives_interval": 5, "tcp_keepalives_count": 2,
    "tcp_user_timeout": GONE_S * 1000,
    "idle_in_transaction_session_timeout": 60_000,  # of a worker that stopped between two statements
    "lock_timeout": BUSY_TIMEOUT_MS,
}  # fmt: skip


class now(FunctionElement[float]):  # noqa: N801
    """Seconds since 1970 UTC by the database's clock, also within a transaction (f64, to a millisecond)."""

    type = sa.Double()
    inherit_cache = True


@compiles(now, "sqlite")
def _now_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(now)
def _now_elsewhere(element: Any, compiler: Any, **options: Any) -> str:
    return "CAST(EXTRACT(EPOCH FROM clock_timestamp()) AS DOUBLE PRECISION)"


def new_id() -> str:
    """Return 32 hexadecimal digits, random."""
    return secrets.token_hex(16)


def insert(tx: sa.Connection, table: sa.Table) -> Any:
    """Return an INSERT into the table that knows ON CONFLICT."""
    return (sqlite if tx.dialect.name == "sqlite" else postgresql).insert(table)


def open_engine(url: str) -> sa.Engine:
    """Return an engine for `url` ("sqlite:////path/farfield.sqlite" or "postgresql://user:password@host/database")."""
    address = sa.make_url(url)
    if address.drivername in ("postgresql", "postgres"):
        address = address.set(drivername="postgresql+psycopg")
    if address.get_backend_name() == "sqlite":
        engine = sa.create_engine(address)
        sa.event.listen(engine, "connect", _prepare_sqlite)
        sa.event.listen(engine, "begin", _begin_sqlite)
    else:
        engine = sa.create_engine(
            address, pool_pre_ping=True, pool_size=POOL, max_overflow=POOL, connect_args=_POSTGRES_TCP
        )
        sa.event.listen(engine, "connect", _prepare_postgres)
    return engine


@contextmanager
def write(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A transaction that may write: committed at the end, rolled back by an exception."""
    with engine.begin() as connection:
        yield connection


@contextmanager
def read(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A transaction that only reads: on SQLite it waits for no writer."""
    with engine.connect() as connection:
        yield connection.execution_options(farfield_read=True)


def _prepare_sqlite(connection: sqlite3.Connection, record: Any) -> None:
    connection.isolation_level = None  # the driver begins nothing by itself
    for pragma in (
        f"busy_timeout = {BUSY_TIMEOUT_MS}",
        "journal_mode = WAL",
        "synchronous = FULL",
        "foreign_keys = ON",
    ):
        connection.execute(f"PRAGMA {pragma}")


def _prepare_postgres(connection: Any, record: Any) -> None:
    """Have the server, too, give up on us when we are cut off: else our locks would outlive us by hours."""
    with connection.cursor() as cursor:
        for name, value in _POSTGRES_SESSION.items():
            cursor.execute(f"SET SESSION {name} = {value}")
    connection.commit()


def _begin_sqlite(connection: sa.Connection) -> None:
    only_reads = connection.get_execution_options().get("farfield_read", False)
    connection.exec_driver_sql("BEGIN" if only_reads else "BEGIN IMMEDIATE")
