"""An artifact store of each kind, and the servers behind them."""

import pytest
from farfield.store.artifacts import open_artifacts
from servers import broker, bucket, postgres, postgres_template, s3_server  # noqa: F401  (fixtures)


@pytest.fixture(params=["folder", "s3"])
def artifacts(request, tmp_path):
    """A store with parts and copies so small that a test can have several of them."""
    if request.param == "folder":
        return open_artifacts(tmp_path / "artifacts")
    store = open_artifacts(request.getfixturevalue("bucket"), cache=tmp_path / "cache", cache_bytes=50 << 20)
    store.part_bytes = 5 << 20
    return store
