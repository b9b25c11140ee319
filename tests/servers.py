"""Real servers for tests, private and gone with the test run: PostgreSQL, a Redis-compatible broker, an S3 (moto's).

All listen on loopback or a unix socket only, with a password each. A server that is not installed skips its tests, and
says so.
"""

import contextlib
import getpass
import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import sqlalchemy as sa
from farfield.store.engine import open_engine
from farfield_workers.broker import broker_command
from farfield_workers.children import die_with_parent
from farfield_workers.serve import migrate

MIGRATIONS = Path(__file__).parents[1] / "migrations"
_POSTGRES = {
    "fsync": "off", "synchronous_commit": "off", "full_page_writes": "off", "shared_buffers": "32MB",
    "max_connections": "120", "log_min_messages": "warning", "deadlock_timeout": "200ms",
}  # fmt: skip


def free_port(host: str = "127.0.0.1") -> int:
    with socket.socket() as found:
        found.bind((host, 0))
        return int(found.getsockname()[1])


def wait_for(port: int, *, host: str = "127.0.0.1", seconds: float = 20.0) -> None:
    """Return once something accepts connections there."""
    end = time.monotonic() + seconds
    while True:
        try:
            socket.create_connection((host, port), 1.0).close()
            return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)


def _programs() -> Path | None:
    """Return the folder with the newest PostgreSQL's programs."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: float(p.parts[-3]))
    on_path = shutil.which("initdb")
    return found[-1].parent if found else Path(on_path).resolve().parent if on_path else None


@dataclass
class Postgres:
    """A running server: an address for each database made in it."""

    folder: Path
    port: int
    password: str
    log: Path

    def url(self, database: str, *, host: str | None = None) -> str:
        """Return the address of a database, over the socket in our folder or over TCP to `host`."""
        where = f"{host}:{self.port}/{database}" if host else f"/{database}?host={self.folder}&port={self.port}"
        return f"postgresql://farfield:{self.password}@{where}"

    def new(self, template: str = "template1") -> str:
        """Make a database like `template` and return its address."""
        name = f"d{secrets.token_hex(6)}"
        engine = open_engine(self.url("postgres"))
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.execute(sa.text(f'CREATE DATABASE {name} TEMPLATE "{template}"'))
        engine.dispose()
        return self.url(name)


@contextmanager
def run_postgres(listen: str = "127.0.0.1", network: str = "") -> Iterator[Postgres]:
    """Run a server of our own, as nobody where we are root, which it refuses to be; `network` may ask it, too."""
    programs = _programs()
    if programs is None:
        pytest.skip("no PostgreSQL server is installed: sh infra/setup/system.sh postgresql")
    user = "nobody" if os.geteuid() == 0 else getpass.getuser()
    folder = Path(tempfile.mkdtemp(prefix="farfield-pg-"))
    password, port = secrets.token_hex(8), free_port()
    (folder / "password").write_text(password)
    account = pwd.getpwnam(user)
    as_user = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []} if os.geteuid() == 0 else {}
    for path in (folder, folder / "password"):
        os.chown(path, account.pw_uid, account.pw_gid)
    data, log = folder / "data", folder / "log"
    process = None
    try:
        initdb = [programs / "initdb", "-D", data, "-U", "farfield", "-A", "scram-sha-256", "--no-sync",
                  f"--pwfile={folder / 'password'}", "-E", "UTF8", "--no-locale"]  # fmt: skip
        subprocess.run(initdb, check=True, capture_output=True, cwd="/", **as_user)
        if network:
            with (data / "pg_hba.conf").open("a") as file:
                file.write(f"host all all {network} scram-sha-256\n")
        options = {**_POSTGRES, "listen_addresses": listen, "port": port, "unix_socket_directories": folder}
        words = [word for name, value in options.items() for word in ("-c", f"{name}={value}")]
        with log.open("wb") as out:
            process = subprocess.Popen(
                [programs / "postgres", "-D", data, *words], cwd="/", stdout=out, stderr=out, start_new_session=True,
                preexec_fn=die_with_parent, **as_user,
            )  # fmt: skip
        server = Postgres(folder, port, password, log)
        engine, end = open_engine(server.url("postgres")), time.monotonic() + 30
        while True:
            try:
                engine.connect().close()
                break
            except sa.exc.OperationalError:
                if process.poll() is not None or time.monotonic() > end:
                    raise AssertionError(log.read_text()) from None
                time.sleep(0.05)
        engine.dispose()
        yield server
    finally:
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGQUIT)
            process.wait(20)
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def run_broker(host: str = "127.0.0.1") -> Iterator[str]:
    """Run a Redis-compatible server over TCP, with a password; yield its address."""
    folder, password, port = Path(tempfile.mkdtemp(prefix="farfield-broker-")), secrets.token_hex(8), free_port()
    command, _ = broker_command(folder)
    command[command.index("--port") + 1] = str(port)
    process = subprocess.Popen(
        [*command, "--bind", host, "--requirepass", password], stdout=subprocess.DEVNULL, preexec_fn=die_with_parent
    )
    try:
        wait_for(port, host="127.0.0.1" if host == "0.0.0.0" else host)
        yield f"redis://:{password}@{host}:{port}/0"
    finally:
        process.terminate()
        process.wait(10)
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def run_s3(host: str = "127.0.0.1") -> Iterator[dict[str, str]]:
    """Run moto's S3 as a process; yield the environment in which boto3 finds it."""
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", host, "-p", str(port)], stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, preexec_fn=die_with_parent, env={**os.environ, "MOTO_S3_DEFAULT_MAX_KEYS": "20"},
    )  # fmt: skip
    try:
        wait_for(port, host="127.0.0.1" if host == "0.0.0.0" else host)
        yield {
            "AWS_ENDPOINT_URL_S3": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "farfield", "AWS_REGION": "us-east-1",
            "AWS_DEFAULT_REGION": "us-east-1", "AWS_SECRET_ACCESS_KEY": secrets.token_hex(8), "NO_PROXY": "*",
        }  # fmt: skip
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5)
        process.kill()


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    with run_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def postgres_template(postgres: Postgres) -> str:
    """The name of a database with our tables, to be copied."""
    url = postgres.new()
    engine = open_engine(url)
    migrate(engine, MIGRATIONS)
    engine.dispose()
    return str(sa.make_url(url).database)


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A SQLite database with our tables, to be copied."""
    path = tmp_path_factory.mktemp("database") / "farfield.sqlite"
    engine = open_engine(f"sqlite:///{path}")
    migrate(engine, MIGRATIONS)
    engine.dispose()
    return path


@pytest.fixture
def database(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of a fresh database with our tables: of SQLite, or of PostgreSQL by the parameter "postgres"."""
    if getattr(request, "param", "sqlite") == "postgres" or request.config.getoption("--postgres"):
        server = request.getfixturevalue("postgres")
        return str(server.new(request.getfixturevalue("postgres_template")))
    shutil.copy(request.getfixturevalue("empty_database"), tmp_path)
    return f"sqlite:///{tmp_path / 'farfield.sqlite'}"


@pytest.fixture(scope="session")
def broker() -> Iterator[str]:
    with run_broker() as url:
        yield url


@pytest.fixture(scope="session")
def s3_server() -> Iterator[dict[str, str]]:
    with run_s3() as environment:
        yield environment


@pytest.fixture
def bucket(s3_server: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of a fresh bucket; boto3 finds it in this process and in those it starts."""
    import boto3

    for name, value in s3_server.items():
        monkeypatch.setenv(name, value)
    name = f"farfield-{secrets.token_hex(6)}"
    boto3.client("s3").create_bucket(Bucket=name)
    return f"s3://{name}/blobs"
