"""The one OpenGL context of this process, made when first asked for.

A child forked from a process that holds a context hangs in its first GL call, so workers are spawned; whoever asks for
a context that another process made is refused.
"""

import os
from typing import Any

from farfield.errors import FarfieldError

GL_VERSION = 430  # shader storage buffers

_made: dict[int, Any] = {}


class NoContext(FarfieldError):
    """EGL gives no OpenGL 4.3 context here."""

    advice = "Install libegl1 and libgl1 (no X needed), or bake with the renderer numba: it gives the same texels."


def context() -> Any:
    """Return this process's moderngl context. Raises NoContext."""
    if os.getpid() not in _made:
        if _made:
            raise NoContext("this process was forked from one that holds an OpenGL context; spawn it instead")
        try:
            import moderngl

            create: Any = moderngl.create_context
            _made[os.getpid()] = create(standalone=True, backend="egl", require=GL_VERSION)
        except Exception as error:  # the loaders raise bare Exception, ImportError, OSError, ValueError
            raise NoContext(f"no OpenGL {GL_VERSION // 100}.{GL_VERSION % 100 // 10} through EGL: {error}") from error
    return _made[os.getpid()]


def name(ctx: Any) -> str:
    """Return vendor, renderer and version of the context's driver."""
    return f"{ctx.info['GL_VENDOR']}, {ctx.info['GL_RENDERER']}, OpenGL {ctx.info['GL_VERSION']}"


def renderer() -> str | None:
    """Return the name of the renderer where this process has made its context; makes none."""
    made = _made.get(os.getpid())
    return name(made) if made is not None else None
