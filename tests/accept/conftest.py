"""The whole demo city: minutes of work and limits on time, so only with --accept (`make accept`)."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from accept.figures import Figures

HERE = Path(__file__).parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--accept"):
        return
    skip = pytest.mark.skip(reason="takes half an hour and measures time: make accept")
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(skip)


@pytest.fixture(scope="session")
def figures() -> Iterator[Figures]:
    table = Figures()
    yield table
    wide = [max((len(row[k]) for row in table.rows), default=0) for k in range(4)]
    text = "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)).rstrip() for row in table.rows)
    print(f"\n\n{text}")
    if kept := os.environ.get("FARFIELD_ACCEPT_OUT"):
        (Path(kept) / "figures.txt").write_text(text + "\n", encoding="utf-8")


@pytest.fixture(scope="session")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = os.environ.get("FARFIELD_ACCEPT_OUT")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("accept")
    folder.mkdir(parents=True, exist_ok=True)
    return folder
