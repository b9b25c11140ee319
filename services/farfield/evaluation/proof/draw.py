"""Draw parts of a view with OpenGL: geometry of the level, or an impostor's layers as the format's page says.

One window of the picture at a time, at the picture's pixels or twice as fine. Targets: colour in linear light, what is
seen (object + 1, or -1 - row of the impostor and texel), depth logarithmic, so that it resolves a millionth of any
distance. Nothing here knows how layers were made.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from farfield.bake.gl.context import context, name
from farfield.evaluation.proof.level import COMMAND, ROW, Level
from farfield.placementdb.read import Impostor, Placement

MOST_IMAGE_BYTES = 256 << 20  # of textures that are kept on the card
_SRGB8_ALPHA8 = 0x8C43
_NEAREST, _LINEAR, _NEAREST_MIPMAP, _LINEAR_MIPMAP = 0x2600, 0x2601, 0x2700, 0x2703
_REPEAT = 10497


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A rectangle of the picture from one viewpoint, and how fine it is drawn."""

    eye: np.ndarray  # (3,) f64  relative to origin_m
    frame: np.ndarray  # (3,3) f64  right, up, forward: unit
    tan: tuple[float, float]  # of half the field of view, x and y
    size: tuple[int, int]  # of the whole picture, pixels
    rect: tuple[int, int, int, int]  # x0, y0, x1, y1, pixels, y upwards
    fine: int = 1  # samples a pixel, along each side

    @property
    def shape(self) -> tuple[int, int]:
        x0, y0, x1, y1 = self.rect
        return (y1 - y0) * self.fine, (x1 - x0) * self.fine

    def uniform(self) -> tuple[float, float, float, float]:
        x0, y0, x1, y1 = self.rect
        return (
            self.size[0] / (self.tan[0] * (x1 - x0)), self.size[1] / (self.tan[1] * (y1 - y0)),
            (self.size[0] - x0 - x1) / (x1 - x0), (self.size[1] - y0 - y1) / (y1 - y0),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Drawn:
    """What a window shows, rows from below upwards."""

    color: np.ndarray  # (h,w,4) f16  linear; alpha 0: background
    what: np.ndarray  # (h,w) i32  object + 1, -1 - row of the impostor's layers, 0 background
    texel: np.ndarray  # (h,w) i32  x | y << 16 in the page, of the impostor
    depth: np.ndarray  # (h,w) f32  logarithmic, 0 near to 1


class Drawer:
    """Programs, the level and what was loaded so far. One a process."""

    def __init__(self, level: Level, placement: Placement, page: Callable[[int], np.ndarray]) -> None:
        """page  returns a page's image. Raises NoContext."""
        self.level, self.placement, self.ctx, self._image_of_page = level, placement, context(), page
        self.name = name(self.ctx)
        folder = resources.files("farfield.evaluation.proof")

        def program(stem: str) -> Any:
            text = [(folder / f"{stem}.{kind}.glsl").read_text() for kind in ("vertex", "fragment")]
            return self.ctx.program(vertex_shader=text[0], fragment_shader=text[1])

        self._geometry, self._layers = program("geometry"), program("layers")
        ctx = self.ctx
        n = max(len(level.row), 1)
        self._rows = ctx.buffer(reserve=n * ROW.itemsize, dynamic=True)
        self._commands = ctx.buffer(reserve=n * COMMAND.itemsize, dynamic=True)
        number = ctx.buffer(np.arange(n, dtype=np.int32))
        columns = (level.position, level.normal, level.uv, level.color)
        filled = [a if len(a) else np.zeros((1, a.shape[1]), a.dtype) for a in columns]
        self._vertices = ctx.vertex_array(
            self._geometry,
            [(ctx.buffer(filled[0]), "3f", "a_position"), (ctx.buffer(filled[1]), "4f2", "a_normal"),
             (ctx.buffer(filled[2]), "4f", "a_uv"), (ctx.buffer(filled[3]), "4f2", "a_color"), (number, "1i/i", "a_row")],
            ctx.buffer(level.index if len(level.index) else np.zeros(1, np.uint32)), index_element_size=4,
        )  # fmt: skip
        plain = {"sun_direction": (0, 1, 0), "sun": (0, 0, 0), "sky": (1, 1, 1), "ground": (1, 1, 1)}
        lighting = placement.manifest["lighting"] or plain
        light = np.array([lighting[k] for k in ("sun_direction", "sun", "sky", "ground")], np.float32)
        self._geometry["u_light"].write(light.tobytes())
        self._white = ctx.texture((1, 1), 4, b"\xff" * 4)
        self._images: dict[int, Any] = {}
        self._pages: dict[int, Any] = {}
        self._targets: dict[tuple[int, int], Any] = {}
        box = placement.index["object_box"]
        size = float(np.sqrt(((box[:, 1].max(0) - box[:, 0].min(0)) ** 2).sum())) if len(box) else 1.0
        self.near = 1e-5 * size + 1e-6
        self.far = 64 * size
        scale = 1 / np.log2(self.far / self.near)
        self.depth = (float(scale), float(-scale * np.log2(self.near)))

    def draw(
        self, window: Window, objects: np.ndarray, impostor: Impostor | None = None, *, whole: bool = False
    ) -> Drawn:
        """Return what the window shows of these objects (b1 a object) and, if given, an impostor's layers.

        whole  every texel that holds anything in full: coverage; else to its share
        """
        import moderngl

        ctx, (height, width) = self.ctx, window.shape
        target = self._target(width, height)
        target.use()
        ctx.viewport = (0, 0, width, height)
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<"
        target.clear(0, 0, 0, 0, depth=1.0, viewport=(0, 0, width, height))
        self._draw_geometry(window, objects)
        if impostor is not None:
            self._draw_layers(window, impostor, whole)
        read = lambda k, components, dtype: np.frombuffer(  # noqa: E731
            target.read(viewport=(0, 0, width, height), components=components, attachment=k, alignment=1, dtype=dtype),
            {"f2": np.float16, "i4": np.int32, "f4": np.float32}[dtype],
        ).reshape(height, width, components)  # fmt: skip
        what = read(1, 2, "i4")
        return Drawn(read(0, 4, "f2"), what[..., 0], what[..., 1], read(-1, 1, "f4")[..., 0])

    def _target(self, width: int, height: int) -> Any:
        key = (-(-width // 256) * 256, -(-height // 256) * 256)
        if key not in self._targets:
            ctx = self.ctx
            self._targets[key] = ctx.framebuffer(
                [ctx.texture(key, 4, dtype="f2"), ctx.texture(key, 2, dtype="i4")], ctx.depth_texture(key)
            )
        return self._targets[key]

    def _set(self, program: Any, window: Window) -> None:
        program["u_camera"].write(np.ascontiguousarray(window.frame.T, np.float32).tobytes())
        program["u_window"].value = window.uniform()
        program["u_near"].value = self.near
        program["u_depth"].value = self.depth

    def _draw_geometry(self, window: Window, objects: np.ndarray) -> None:
        level = self.level
        rows = np.flatnonzero(objects[level.row_object])
        if not len(rows):
            return
        moved = level.row.copy()
        moved["matrix"][:, :, 3] = level.matrix[level.row_object, :, 3] - window.eye
        self._rows.write(moved)
        self._rows.bind_to_storage_buffer(0)
        self._commands.write(level.command[rows])
        self._set(self._geometry, window)
        self._geometry["u_texture"].value, self._geometry["u_glow"].value = 0, 1
        textures = level.row_textures[rows]
        starts = np.flatnonzero(np.concatenate([[True], (textures[1:] != textures[:-1]).any(1)]))
        for a, b in zip(starts.tolist(), [*starts[1:].tolist(), len(rows)], strict=True):
            for unit in range(2):
                self._image(int(textures[a, unit])).use(unit)
            self._vertices.render_indirect(self._commands, mode=4, count=b - a, first=a)

    def _image(self, texture: int) -> Any:
        if texture < 0:
            return self._white
        if texture not in self._images:
            held = sum(t.size[0] * t.size[1] * 4 for t in self._images.values())
            if held > MOST_IMAGE_BYTES:
                for old in self._images.values():
                    old.release()
                self._images.clear()
            image, raw = np.ascontiguousarray(self.level.image(texture)), self.level.raw.textures[texture]
            made = self.ctx.texture(image.shape[1::-1], 4, image, internal_format=_SRGB8_ALPHA8)
            made.build_mipmaps()
            made.filter = (_LINEAR_MIPMAP if raw.smooth else _NEAREST_MIPMAP, _LINEAR if raw.linear else _NEAREST)
            made.repeat_x, made.repeat_y = (w == _REPEAT for w in raw.wrap)
            self._images[texture] = made
        return self._images[texture]

    def _page(self, page: int) -> Any:
        if page not in self._pages:
            if len(self._pages) >= 16:
                self._pages.pop(next(iter(self._pages))).release()
            image = np.ascontiguousarray(self._image_of_page(page))
            made = self.ctx.texture(image.shape[1::-1], 4, image)
            made.filter = (_NEAREST, _NEAREST)
            self._pages[page] = made
        return self._pages[page]

    def _draw_layers(self, window: Window, impostor: Impostor, whole: bool) -> None:
        ctx, program = self.ctx, self._layers
        self._set(program, window)
        eye = impostor.eye - self.placement.origin_m - window.eye
        program["u_eye"].value = tuple(eye.astype(np.float32).tolist())
        program["u_forward"].value = tuple(window.frame[2].tolist())
        program["u_whole"].value = int(whole)
        program["u_page"].value = 0
        levels = [(p["x"], p["y"], 0) for p in self.placement.manifest["page"]["levels"]]
        program["u_levels"].value = levels
        rows = np.zeros(len(impostor.layers), [("range", "<f4", 4), ("rect", "<i4", 4)])
        corners: dict[int, list[np.ndarray]] = {}
        for r, layer in enumerate(impostor.layers):
            rows[r]["range"][:3] = layer.plane, 1 / layer.near, 0.0 if np.isinf(layer.far) else 1 / layer.far
            rows[r]["rect"] = layer.rect
            made = np.zeros(len(layer.position), [("position", "<f4", 3), ("uv", "<f4", 2), ("layer", "<i4")])
            made["position"], made["uv"], made["layer"] = layer.position, layer.uv, r
            fan = [made[[0, k, k + 1]] for k in range(1, len(made) - 1)]
            corners.setdefault(layer.page, []).extend(fan)
        if not corners:
            return
        buffer = ctx.buffer(rows)
        buffer.bind_to_storage_buffer(1)
        for page, fans in corners.items():
            self._page(page).use(0)
            vertices = ctx.buffer(np.concatenate(fans))
            array = ctx.vertex_array(program, [(vertices, "3f 2f 1i", "a_position", "a_uv", "a_layer")])
            array.render(4)
            array.release()
            vertices.release()
        buffer.release()
