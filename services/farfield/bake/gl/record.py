"""Record layers with OpenGL: the sheet of `farfield.bake.coverage.record`, piece for piece the same.

Problem  Conservative rasterisation is an extension that many drivers lack, and each has its own idea of it.
Method   Each piece is drawn as the rectangle of texels around it (exactly: corners on texel corners), cut into blocks.
         The fragment shader decides with the integer separating-axis test of coverage.py, repeats its float32 depth
         with `precise` (no fused products) and writes the piece's number; the depth test keeps the nearest, the first
         on a tie. All layers of a pass lie side by side in one sheet: one draw call a quarter of a million blocks, one
         read. Masked materials are added on the processor, by the same code as in the numba path: no texture goes to
         GL.
"""

from importlib import resources
from typing import Any

import numpy as np

from farfield.bake.coverage import add_masked
from farfield.bake.gl.blocks import fill
from farfield.bake.gl.context import context, name
from farfield.bake.records import Pieces, Slabs, Sources, Surface

BLOCKS = 1 << 18  # of one draw call: 28 MB of integers, below the 128 MB that drivers grant a storage buffer


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
        self._whole = np.empty((BLOCKS, 27), np.int32)
        self._real = np.empty((BLOCKS, 8), np.float32)
        self._whole_buffer = self._ctx.buffer(reserve=self._whole.nbytes, dynamic=True)
        self._real_buffer = self._ctx.buffer(reserve=self._real.nbytes, dynamic=True)
        self._vertices = self._ctx.vertex_array(self._program, [])
        self._size = (0, 0)
        self._target: Any = None
        self.most_side = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])

    def record(
        self, sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int],
        sheet_size: tuple[int, int],
    ) -> np.ndarray:  # fmt: skip
        """As `farfield.bake.coverage.record`. Sheets beyond `most_side` fail in the driver."""
        import moderngl

        ctx, (width, height) = self._ctx, sheet_size
        self._reserve(width, height)
        self._target.use()
        ctx.viewport = (0, 0, width, height)
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<"
        self._target.clear(0, 0, 0, 0, depth=1.0, viewport=(0, 0, width, height))
        self._program["sheet"].value = (float(width), float(height))
        start, end = int(pieces.row[layers[0]]), int(pieces.row[layers[1]])
        while start < end:
            n, start = fill(sources, pieces, slabs, surface, layers, start, self._whole, self._real)
            if n:
                self._whole_buffer.write(self._whole[:n])
                self._real_buffer.write(self._real[:n])
                self._whole_buffer.bind_to_storage_buffer(0)
                self._real_buffer.bind_to_storage_buffer(1)
                self._vertices.render(moderngl.TRIANGLES, vertices=6 * n)
        data = self._target.read(viewport=(0, 0, width, height), components=1, alignment=4, dtype="u4")
        sheet = np.frombuffer(bytearray(data), np.uint32).reshape(height, width)
        add_masked(sheet, sources, pieces, slabs, surface, layers)
        return sheet

    def _reserve(self, width: int, height: int) -> None:
        size = (max(width, self._size[0]), max(height, self._size[1]))
        if size != self._size:
            if self._target is not None:
                for part in (*self._target.color_attachments, self._target.depth_attachment, self._target):
                    part.release()
            self._target = self._ctx.framebuffer(
                [self._ctx.texture(size, 1, dtype="u4")], self._ctx.depth_renderbuffer(size)
            )
            self._size = size
