"""What tests of every folder share: the one OpenGL context of this process."""

from typing import Any

import pytest


@pytest.fixture(scope="session")
def gl() -> Any:
    """The moderngl context of `farfield.bake.gl`; skips, and says so, where EGL gives none."""
    from farfield.bake.gl.context import NoContext, context

    try:
        return context()
    except NoContext as error:
        pytest.skip(f"{error} {error.advice}")
