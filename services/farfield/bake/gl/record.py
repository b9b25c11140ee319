"""Record layers with OpenGL: the sheet of `farfield.bake.coverage.record`, piece for piece the same.

Problem  Conservative rasterisation is an extension that many drivers lack, and each has its own idea of it.
Method   Each piece is drawn as the rectangle of texels around it (exactly: corners on texel corners), cut into blocks.
         The fragment shader decides with the integer separating-axis test of coverage.py, repeats its float32 depth
         with `precise` (no fused products) and writes the piece's number; the depth test keeps the nearest, the first
         on a tie. All layers of a pass lie side by side in one sheet: one draw call a quarter of a million blocks, one
         read. Masked materials are added on the processor, by the same code as in the numba path: no texture goes to
         GL.
Apart    Bakes draw in a child process (`apart`), which needs neither numba nor the scene: blocks go there, sheets come
         back. Where it is lost, the sheet is recorded again by a new one; where that is lost, too, the shard fails, and is
         tried again.
"""

from functools import cache
from importlib import resources
from typing import Any, Protocol

import numpy as np

from farfield.bake.gl.apart import ContextLost, child
from farfield.bake.gl.context import context, name
from farfield.bake.records import Pieces, Slabs, Sources, Surface

BLOCKS = 1 << 18  # of one draw call: 28 MB of integers, below the 128 MB that drivers grant a storage buffer


class Draws(Protocol):
    """What can draw blocks: a Recorder here, or one in a child process."""

    def begin(self, width: int, height: int) -> None: ...

    def blocks(self, whole: np.ndarray, real: np.ndarray) -> None: ...

    def end(self) -> np.ndarray: ...


def record_with(
    draws: Draws, sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int],
    sheet_size: tuple[int, int],
) -> np.ndarray:  # fmt: skip
    """As `farfield.bake.coverage.record`. Sheets beyond the largest texture fail in the driver."""
    from farfield.bake.coverage import add_masked
    from farfield.bake.gl.blocks import fill

    draws.begin(*sheet_size)
    start, end = int(pieces.row[layers[0]]), int(pieces.row[layers[1]])
    n_blocks = min(BLOCKS, max(1 << 12, 4 * (end - start)))
    whole, real = np.empty((n_blocks, 27), np.int32), np.empty((n_blocks, 8), np.float32)
    while start < end:
        n, start = fill(sources, pieces, slabs, surface, layers, start, whole, real)
        if n:
            draws.blocks(whole[:n], real[:n])
    sheet = draws.end()
    if int(sheet.max(initial=0)) > len(pieces.source):
        raise ContextLost("OpenGL returned texels of pieces that there are not")
    add_masked(sheet, sources, pieces, slabs, surface, layers)
    return sheet


class Recorder:
    """Keeps program, buffers and the largest sheet so far. One a process; not to be shared between threads."""

    def __init__(self) -> None:
        self._ctx = context()
        self.name = name(self._ctx)
        folder = resources.files("farfield.bake.gl")
        self._program = self._ctx.program(
            vertex_shader=(folder / "coverage.vertex.glsl").read_text(),
            fragment_shader=(folder / "coverage.fragment.glsl").read_text(),
        )
        self._whole_buffer = self._ctx.buffer(reserve=BLOCKS * 27 * 4, dynamic=True)
        self._real_buffer = self._ctx.buffer(reserve=BLOCKS * 8 * 4, dynamic=True)
        self._vertices = self._ctx.vertex_array(self._program, [])
        self._size, self._sheet = (0, 0), (0, 0)
        self._target: Any = None
        self.most_side = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])

    def record(self, *given: Any) -> np.ndarray:
        """As `farfield.bake.coverage.record`, in this process."""
        return record_with(self, *given)

    def begin(self, width: int, height: int) -> None:
        """Start an empty sheet."""
        import moderngl

        ctx = self._ctx
        self._reserve(width, height)
        self._sheet = width, height
        self._target.use()
        ctx.viewport = (0, 0, width, height)
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<"
        self._target.clear(0, 0, 0, 0, depth=1.0, viewport=(0, 0, width, height))
        self._program["sheet"].value = (float(width), float(height))

    def blocks(self, whole: np.ndarray, real: np.ndarray) -> None:
        """Draw blocks (n,27) i32 and (n,8) f32, n at most BLOCKS: see farfield.bake.gl.blocks."""
        self._whole_buffer.write(whole)
        self._real_buffer.write(real)
        self._whole_buffer.bind_to_storage_buffer(0)
        self._real_buffer.bind_to_storage_buffer(1)
        self._vertices.render(4, vertices=6 * len(whole))
        # Before the buffers are written again: llvmpipe reads them when it shades, not when it is told to draw.
        self._ctx.finish()

    def end(self) -> np.ndarray:
        """Return the sheet (height, width) u32."""
        width, height = self._sheet
        sheet = np.empty((height, width), np.uint32)
        self._target.read_into(sheet, viewport=(0, 0, width, height), components=1, alignment=4, dtype="u4")
        if self._ctx.error != "GL_NO_ERROR":  # out of memory, or a device that went away
            raise ContextLost("OpenGL reports an error after a sheet was drawn")
        return sheet

    def _reserve(self, width: int, height: int) -> None:
        size = (max(width, self._size[0]), max(height, self._size[1]))
        if size != self._size:
            old, self._target = (
                self._target,
                self._ctx.framebuffer([self._ctx.texture(size, 1, dtype="u4")], self._ctx.depth_renderbuffer(size)),
            )
            self._target.use()  # before the old one goes: while one that is gone is bound, calls fail
            if old is not None:
                for part in (*old.color_attachments, old.depth_attachment, old):
                    part.release()
            self._size = size


@cache
def _here() -> Recorder:
    return Recorder()


def here_name() -> str:
    """Return the driver's name, in the process that draws. Raises NoContext."""
    return _here().name


def here_begin(width: int, height: int) -> None:
    _here().begin(width, height)


def here_blocks(whole: np.ndarray, real: np.ndarray) -> None:
    _here().blocks(whole, real)


def here_end() -> np.ndarray:
    return _here().end()


class RecorderApart:
    """A Recorder in this process's child."""

    def __init__(self) -> None:
        """Raises NoContext, ContextLost."""
        self.name = str(child().call("farfield.bake.gl.record:here_name"))

    def record(self, *given: Any) -> np.ndarray:
        """As `farfield.bake.coverage.record`. Raises ContextLost where two children in a row are lost."""
        try:
            return record_with(self, *given)
        except ContextLost:
            return record_with(self, *given)

    def begin(self, width: int, height: int) -> None:
        child().call("farfield.bake.gl.record:here_begin", width, height)

    def blocks(self, whole: np.ndarray, real: np.ndarray) -> None:
        child().call("farfield.bake.gl.record:here_blocks", whole, real)

    def end(self) -> np.ndarray:
        found = child().call("farfield.bake.gl.record:here_end")
        assert isinstance(found, np.ndarray)
        return found
