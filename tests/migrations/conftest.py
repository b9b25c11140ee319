"""An empty database of each kind."""

import pytest
from farfield.store.engine import open_engine
from servers import postgres  # noqa: F401  (fixture)


@pytest.fixture(params=["sqlite", "postgres"])
def empty(request, tmp_path):
    """The address of a database without tables."""
    if request.param == "postgres":
        return request.getfixturevalue("postgres").new()
    return f"sqlite:///{tmp_path / 'a.sqlite'}"


@pytest.fixture
def engine(empty):
    engine = open_engine(empty)
    yield engine
    engine.dispose()
