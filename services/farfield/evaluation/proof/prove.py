"""Prove impostors by pictures: the whole level with an impostor against the whole level with its geometry.

Problem  The error metric says that from everywhere in its view cell an impostor shows its geometry to within the pixel
         error and without a crack. Try to refute it with nothing but the files that a viewer reads.
Method   Random (impostor, viewpoint) pairs from where it is shown (`pairs`). Each is drawn four times at the camera's
         resolution, in the window around the impostor: its geometry alone and its layers alone (what is covered), the
         level with geometry and with the impostor (what is seen). `judge` compares them. `hidden` are pixels whose
         geometry shows in the one picture and which another object covers in the other although the impostor is there:
         depth within a slab has 62 steps, so what touches it may win; they are counted, and seen in FLIP, not failed.
         A pair fails by a crack, by a displacement above the pixel error, or by WRONG_SHARE of its texels at depths
         where no surface is.
Errs     A pair in which nothing of the impostor is in the picture proves nothing and is not counted; one that the rest
         of the level hides still counts for cracks and displacement (`pairs_in_view` counts the others). A window of more
         than MOST pixels is looked at in part. Blended materials and levels of detail are in neither picture.
Measured Five real scenes, 1280 x 720, 45 degrees, pixel error 1, some 2,150 pairs each (Munich, San Francisco, folio2025,
         kenney-city, dream-apartment): no crack pixel in 36 million, 0.92 to 0.99 px at most, 0.10 to 0.13 in the mean.
         30 to 90 ms of CPU a pair on llvmpipe, 55 more where FLIP is asked. Which bake, and what it leaves: docs/evidence.md.
"""

import base64
import io
import itertools
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from farfield.bake.gl.apart import ContextLost, child
from farfield.bake.gl.context import NoContext
from farfield.evaluation.proof.draw import Drawer, Window
from farfield.evaluation.proof.judge import Moved, Tracer, difference, displacement, inside, shrunk
from farfield.evaluation.proof.level import Level
from farfield.evaluation.proof.merge import PICTURES, badness
from farfield.evaluation.proof.pairs import Pair, Shown, frame_of, rect_of, tangents
from farfield.placementdb.read import Impostor, Placement

MARGIN, MOST = 12, 512  # pixels around the impostor; side of a window
PART = 128  # pixels drawn at 8 x 8 samples at a time: a whole window of them would take 335 MB
TOLERANCE = 1e-3  # of the pixel error: float32 positions of corners
WRONG_SHARE, WRONG_LEAST = 0.01, 4  # texels off in depth that fail an impostor; sound ones have none
BACKGROUND = np.array([0.34, 0.5, 0.64])  # linear
PICTURE_SIDE = 320
PAGES = 16  # decoded, 6 MB each


def prove(folder: Path, first: int, count: int, *, seed: int, each: int) -> dict[str, Any]:
    """Return what pairs [first, first + count) of the placement in `folder` show, as JSON values, for `merge_proofs`.

    each  viewpoints an impostor, in order of ids; 0: impostors at random. Where there is no OpenGL no pair is tried, and
    `not_proven` says so. Raises what reading the files raises.
    """
    try:
        prover = Prover(folder)
    except NoContext as error:
        return {
            "rows": [],
            "unseen": 0,
            "renderer": None,
            "allowed_px": None,
            "impostors_shown": 0,
            "not_proven": str(error),
        }
    return prover.prove(first, count, seed=seed, each=each)


def prove_apart(folder: Path, first: int, count: int, *, seed: int, each: int) -> dict[str, Any]:
    """As `prove`, in a process of its own: twice, if a driver takes the first one with it. Raises ContextLost."""
    call = partial(child().call, "farfield.evaluation.proof.prove:prove_pairs", str(folder), first, count, seed, each)
    try:
        try:
            found = call()
        except ContextLost:
            found = call()
        return dict(found)
    finally:
        child().end()  # its textures


def prove_pairs(folder: str, first: int, count: int, seed: int, each: int) -> dict[str, Any]:
    """As `prove`, with arguments that travel."""
    return prove(Path(folder), first, count, seed=seed, each=each)


class Prover:
    """A placement's folder, ready to be looked at. Raises NoContext, and what reading its files raises."""

    def __init__(self, folder: Path) -> None:
        self.placement = Placement.open(folder / "placement")
        self._page_of: dict[int, np.ndarray] = {}
        index = self.placement.index
        self.level = Level(folder / "scene.glb", index["object_box"], self.placement.origin_m)
        self.drawer = Drawer(self.level, self.placement, self._page)
        self.shown = Shown(self.placement)
        self.tan = tangents(self.placement)
        camera, quality = self.placement.manifest["camera"], self.placement.manifest["quality"]
        self.size = camera["width"], camera["height"]
        k = 1 + self.tan[0] ** 2 + self.tan[1] ** 2
        self.pixel = 2 * self.tan[1] / camera["height"]
        self.allowed = float(quality["pixel_error"]) / (k if quality["pixels_at"] == "anywhere" else 1.0)
        self.reach = math.ceil(self.allowed * k)
        self._tracers: dict[int, Tracer] = {}

    def prove(self, first: int, count: int, *, seed: int, each: int) -> dict[str, Any]:
        """Return what pairs [first, first + count) show, as JSON values; see `merge_proofs` for the keys."""
        drawn = [(number, *self.shown.pair(number, seed, each)) for number in range(first, first + count)]
        rows: list[dict[str, Any]] = []
        # neighbours share pages
        for number, pair, seen in sorted(drawn, key=lambda d: (d[1].impostor, d[0])):
            row = self._judge(pair) if seen else None
            if row is not None:
                rows.append({"pair": number, **row})
            for dropped in sorted(rows, key=badness, reverse=True)[PICTURES:]:
                dropped["pictures"] = None
        rows.sort(key=lambda row: int(row["pair"]))
        for row in rows:
            pictures = row["pictures"]
            row["pictures"] = None if pictures is None else self._keep(pictures)
        return {"rows": rows, "unseen": count - len(rows), "renderer": self.drawer.name, "allowed_px": self.allowed,
                "impostors_shown": len(self.shown.impostors)}  # fmt: skip

    def _judge(self, pair: Pair) -> dict[str, Any] | None:
        placement, index = self.placement, self.placement.index
        impostor: Impostor = placement.impostors[pair.impostor]
        rect = rect_of(placement, pair)
        assert rect is not None
        own = np.zeros(len(index["object_box"]), bool)
        own[impostor.objects] = True
        start, stop = (index[f"cluster_{end}"][index["impostor_cluster"]] for end in ("start", "stop"))
        lookup = placement.lookup(pair.position, pair.direction)
        all_objects = own.copy()
        all_objects[lookup.objects] = True
        for other in lookup.impostors:
            all_objects[start[other] : stop[other]] = True
        window = Window(
            eye=pair.position - placement.origin_m, frame=frame_of(pair.direction), tan=self.tan, size=self.size,
            rect=self._part(rect),
        )  # fmt: skip
        nothing = np.zeros_like(own)
        geometry = self.drawer.draw(window, own)
        layers = self.drawer.draw(window, nothing, impostor, whole=True)
        covered = layers.what < 0
        if not covered.any() and not (geometry.what > 0).any():
            return None
        cracks = inside(geometry.what > 0, self.reach) & ~covered
        if cracks.any():  # a slit of the geometry between two pixels' centres is no surface: look closer
            cracks &= inside(self._solid(window, own), self.reach)
        moved = self._moved(impostor, layers.what, layers.texel, pair)
        fine = Window(eye=window.eye, frame=window.frame, tan=window.tan, size=window.size, rect=window.rect, fine=2)
        near = self._near(all_objects, fine)
        flip, pictures, hidden, seen_px = np.zeros(1), None, 0, 0
        together = self.drawer.draw(window, near, impostor, whole=True).what
        if ((together < 0) | own[np.maximum(together - 1, 0)] & (together > 0)).any():  # else the level hides it
            truth, shown = self.drawer.draw(fine, near), self.drawer.draw(fine, near & ~own, impostor)
            shows = own[np.maximum(truth.what - 1, 0)] & (truth.what > 0)
            wide = np.repeat(np.repeat(covered, 2, 0), 2, 1)
            hidden = int((inside(shows, 2 * self.reach) & (shown.what >= 0) & wide).sum())
            area = (shows | (shown.what < 0)).reshape(covered.shape[0], 2, covered.shape[1], 2).any((1, 3))
            seen_px = int(area.sum())
            if seen_px:
                pictures = shrunk(truth.color, BACKGROUND), shrunk(shown.color, BACKGROUND)
                rows, columns = (
                    slice(max(int(n.min()) - MARGIN, 0), int(n.max()) + MARGIN) for n in np.nonzero(area)
                )  # fmt: skip
                flip = difference(*(p[rows, columns] for p in pictures))[area[rows, columns]]
        n_cracks = int(cracks.sum())
        row = {
            "impostor": pair.impostor, "position": pair.position.tolist(), "direction": pair.direction.tolist(),
            "pixels": int((covered | (geometry.what > 0)).sum()), "seen_px": seen_px, "crack_px": n_cracks,
            "hidden_px": hidden / 4, "texels": moved.texels, "open_texels": moved.open,
            "wrong_texels": moved.wrong, "displacement_px": moved.largest, "displacement_sum_px": moved.total,
            "flip": float(flip.mean()), "flip_p95": float(np.percentile(flip, 95)),
        }  # fmt: skip
        wrong = moved.wrong > WRONG_SHARE * moved.texels + WRONG_LEAST
        row["failed"] = bool(n_cracks or moved.largest > self.allowed * (1 + TOLERANCE) or wrong)
        return {**row, "pictures": pictures}

    def _part(self, rect: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """Return the window: with a margin, at most MOST pixels wide and high (the middle of what is larger)."""
        out = []
        for axis in (0, 1):
            low, high = max(rect[axis] - MARGIN, 0), min(rect[axis + 2] + MARGIN, self.size[axis])
            if high - low > MOST:
                low = (low + high - MOST) // 2
                high = low + MOST
            out.append((low, high))
        return out[0][0], out[1][0], out[0][1], out[1][1]

    def _solid(self, window: Window, own: np.ndarray) -> np.ndarray:
        """Return (h,w) b1: pixels whose geometry covers all of 8 x 8 samples."""
        x0, y0, x1, y1 = window.rect
        solid = np.zeros(window.shape, bool)
        for y, x in itertools.product(range(y0, y1, PART), range(x0, x1, PART)):
            rect = x, y, min(x + PART, x1), min(y + PART, y1)
            fine = Window(eye=window.eye, frame=window.frame, tan=window.tan, size=window.size, rect=rect, fine=8)
            what = self.drawer.draw(fine, own).what > 0
            height, width = rect[3] - rect[1], rect[2] - rect[0]
            solid[y - y0 : y - y0 + height, x - x0 : x - x0 + width] = what.reshape(height, 8, width, 8).all((1, 3))
        return solid

    def _near(self, objects: np.ndarray, window: Window) -> np.ndarray:
        """Return those of the objects whose box may be in the window; errs towards keeping."""
        box = self.placement.index["object_box"] - window.eye
        x0, y0, x1, y1 = window.rect
        (tan_x, tan_y), (width, height) = window.tan, window.size
        right, up, ahead = window.frame
        keep = objects.copy()
        for normal in (
            right - (2 * x0 / width - 1) * tan_x * ahead, (2 * x1 / width - 1) * tan_x * ahead - right,
            up - (2 * y0 / height - 1) * tan_y * ahead, (2 * y1 / height - 1) * tan_y * ahead - up, ahead,
        ):  # fmt: skip
            best = np.where(normal > 0, box[:, 1], box[:, 0])
            keep &= (best * normal).sum(1) >= -1e-6
        return keep

    def _moved(self, impostor: Impostor, what: np.ndarray, texel: np.ndarray, pair: Pair) -> Moved:
        if impostor.id not in self._tracers:
            if len(self._tracers) >= 16:
                self._tracers.pop(next(iter(self._tracers)))
            corner = self.level.triangles(impostor.objects, impostor.eye - self.placement.origin_m)
            self._tracers[impostor.id] = Tracer(corner)
        return displacement(
            impostor, self._tracers[impostor.id], what, texel, self._page, pair.position - impostor.eye, self.pixel
        )

    def _page(self, page: int) -> np.ndarray:
        if page not in self._page_of:
            if len(self._page_of) >= PAGES:
                self._page_of.pop(next(iter(self._page_of)))
            self._page_of[page] = self.placement.page(page)
        return self._page_of[page]

    def _keep(self, pictures: tuple[np.ndarray, np.ndarray]) -> dict[str, str]:
        """Return geometry, impostor and difference (fourfold) as addresses, cut to PICTURE_SIDE around the middle."""
        made = [np.round(p * 255).astype(np.uint8)[::-1] for p in pictures]
        apart = np.abs(made[0].astype(np.int16) - made[1]).max(-1)
        made.append(np.repeat(np.clip(4 * apart, 0, 255).astype(np.uint8)[..., None], 3, 2))
        y, x = (max((n - PICTURE_SIDE) // 2, 0) for n in apart.shape)
        cut = [np.ascontiguousarray(m[y : y + PICTURE_SIDE, x : x + PICTURE_SIDE]) for m in made]
        return {key: data_uri(m) for key, m in zip(("geometry", "impostor", "difference"), cut, strict=True)}


def data_uri(picture: np.ndarray) -> str:
    """Return a lossless WebP of (h,w,3) u1 as an address that a page can show."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(picture).save(out, "WEBP", lossless=True, method=4)
    return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode()
