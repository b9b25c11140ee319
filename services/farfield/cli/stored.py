"""What the operator's verbs share: the database and the artifacts that they work on, found where the service has them."""

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from farfield.errors import ServiceError

if TYPE_CHECKING:
    import sqlalchemy as sa

    from farfield.store.artifacts import Artifacts


def add_stored(parser: argparse.ArgumentParser) -> None:
    """Add the option that says where the service keeps its state."""
    parser.add_argument(
        "--data", type=Path, metavar="DIR",
        help="state of `farfield serve` (default: data, unless FARFIELD_DATABASE_URL and FARFIELD_ARTIFACTS are set)",
    )  # fmt: skip


@contextmanager
def opened(args: argparse.Namespace) -> "Iterator[tuple[sa.Engine, Artifacts]]":
    """The database and the artifacts. Raises ServiceError where there are none."""
    from farfield.store.artifacts import open_artifacts
    from farfield.store.engine import open_engine

    url, store = os.environ.get("FARFIELD_DATABASE_URL"), os.environ.get("FARFIELD_ARTIFACTS")
    if args.data is not None or url is None or store is None:
        data = args.data or Path("data")
        if not (data / "farfield.sqlite").is_file():
            raise ServiceError(f"{data} holds no farfield.sqlite: give --data, or set FARFIELD_DATABASE_URL")
        url, store = f"sqlite:///{(data / 'farfield.sqlite').resolve()}", str(data / "artifacts")
    cache = os.environ.get("FARFIELD_CACHE")
    engine = open_engine(url)
    try:
        yield engine, open_artifacts(store, cache=Path(cache) if cache else None)
    finally:
        engine.dispose()


def size(n_bytes: int) -> str:
    """Return bytes for people: "1.5 GiB"."""
    amount, units = float(n_bytes), ("bytes", "KiB", "MiB", "GiB", "TiB")
    for unit in units:
        if amount < 1024 or unit == units[-1]:
            break
        amount /= 1024
    return f"{amount:.0f} {unit}" if unit == "bytes" else f"{amount:.1f} {unit}"
