"""What tests of every folder share: options, hypothesis' profile, the one OpenGL context of this process."""

from typing import Any

import pytest
from hypothesis import settings

# A compile in the first example is no failure; the same examples every time, so that a red run can be repeated.
settings.register_profile("farfield", deadline=None, derandomize=True)
settings.load_profile("farfield")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--accept", action="store_true", help="also place the whole demo city and check its figures")
    parser.addoption(
        "--chaos",
        type=int,
        nargs="?",
        const=25,
        default=1,
        metavar="RUNS",
        help="disturb the service so often (tests/chaos)",
    )
    parser.addoption("--chaos-first", type=int, default=0, metavar="SEED", help="... from this seed on")
    parser.addoption("--postgres", action="store_true", help="run all tests of API and workers on PostgreSQL")
    parser.addoption("--images", action="store_true", help="also install what each image installs, and start it")
    parser.addoption("--bench", action="store_true", help="run the benchmarks (tests/benchmarks)")
    parser.addoption("--bench-large", action="store_true", help="... and those that take minutes each")
    parser.addoption("--hostile", action="store_true", help="also read hundreds of broken levels of every format")
    parser.addoption("--bench-save", action="store_true", help="keep their rows in tests/benchmarks/results")


@pytest.fixture(scope="session")
def gl() -> Any:
    """The moderngl context of `farfield.bake.gl`; skips, and says so, where EGL gives none."""
    from farfield.bake.gl.context import NoContext, context

    try:
        return context()
    except NoContext as error:
        pytest.skip(f"{error} {error.advice}")
