"""Every setting with its default, unit and range, once. TOML file, API body and report use the same keys.

`resolve` is not here: what is derived from a scene (view space, cell size) is derived in `farfield.scene.derive`.
"""

import dataclasses
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal

from farfield.errors import SettingsInvalid

Corner = tuple[float, float, float]
Box = tuple[Corner, Corner]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    unit_m: float | None = None  # metres per unit of the file, > 0; None: 1, or what the format says
    up: Literal["y", "z"] | None = None  # the file's up axis; None: y, or what the format says
    split_triangles: int = 2048  # what a piece of a split mesh has at least, 16..1,000,000


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    fov_deg: float = 45.0  # vertical, (0, 150]
    width: int = 1280  # pixels, 16..16384
    height: int = 720  # pixels, 16..16384


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSpaceSettings:
    boxes: tuple[Box, ...] | None = None  # scene metres; None: derived from the scene
    cell_m: float | None = None  # side of the smallest cell, > 0; None: derived from the scene
    interval_deg: float = 11.25  # smallest direction interval; 90, 45, 22.5, 11.25 or 5.625


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySettings:
    pixel_error: float = 1.0  # admissible parallax, output pixels, (0, 64]
    pixels_at: Literal["centre", "anywhere"] = "centre"  # where on the screen that pixel is measured


@dataclass(frozen=True, slots=True, kw_only=True)
class DetailSettings:
    mode: Literal["auto", "on", "off"] = (
        "auto"  # coarser meshes for far objects; auto: where triangles are what is spent
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibilitySettings:
    mode: Literal["auto", "sampled", "conservative", "off"] = "auto"
    missed_ppm: float = 35.0  # missed pixels a million at which sampling stops, as a 95 % bound, (0, 1e6]
    rays: int = 400_000  # ... or after as many rays a cell, 1000..10**9


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementSettings:
    candidates: Literal["shafts+boxes", "shafts", "boxes", "cells", "environment"] = "shafts+boxes"
    far_m: float = 300.0  # environment: half the side of the cube that stays geometry around each cell, (0, 1e9]
    view_cells: Literal["tight", "raw"] = "tight"  # fitted to the cells they serve, or as generated
    density: float = 1.0  # of candidates: below 1 fewer of the sets of cells are kept, above 1 more, [0.001, 1000]
    assignment: Literal["fastest", "least", "all"] = "fastest"  # which of its impostors a view shows
    reverse_delete: bool = True  # drop chosen impostors that no view needs
    hopeless: Literal["near_best", "geometry"] = "near_best"  # what views get that cannot meet the budget
    hopeless_slack: float = 1.05  # near_best: their target in multiples of the best they can reach, [1, 10]
    regions: int = 1  # 1..64 parts of the view space, optimised apart and merged
    bound: Literal["auto", "lp", "lagrangian", "off"] = "auto"  # how to prove what no placement can weigh less than
    time_limit_s: float | None = None  # of optimising, wall clock, > 0; None: as long as it takes
    base: str | None = None  # what `place --from` keeps: manifest_sha256 of an earlier placement; None: from scratch


@dataclass(frozen=True, slots=True, kw_only=True)
class BakeSettings:
    flatten: Literal["none", "shine", "all"] = "shine"  # what is baked although no picture can hold it; else geometry
    page_format: Literal["webp", "png", "ktx2"] = "webp"  # of atlas pages, all lossless


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofSettings:
    mode: Literal["sample", "all", "off"] = "sample"  # which impostors are compared with their geometry, in pictures
    pairs: int = 160  # sample: random (impostor, viewpoint) pairs, 1..10**6
    views: int = 2  # all: viewpoints an impostor, 1..1000
    confidence: float = 0.95  # of the stated bound of what fails, [0.5, 0.9999]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How a fitted device profile lies over its samples: predicted - measured, milliseconds."""

    samples: int
    quantile: float  # share of the samples that the fit was to leave not above its prediction
    mean_ms: float
    p95_ms: float
    worst_ms: float  # the most that a frame took longer than predicted, >= 0
    under_share: float  # of the samples that took longer than predicted
    unseen_under_share: float  # the same of samples that the fit had not seen, five fits over a fifth each


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceProfile:
    """What drawing costs on a device [placement.md section 3]: each an upper bound, nanoseconds, [0, 1e9]."""

    per_frame_ns: int  # everything a frame costs before anything is drawn, the impostors' batches included
    per_call_ns: float
    per_triangle_ns: float
    per_pixel_ns: float  # a pixel of an object's bounding area
    per_impostor_ns: float
    per_impostor_triangle_ns: float
    per_impostor_pixel_ns: float  # a pixel of an impostor layer, empty texels included
    fit: Fit | None = None  # None: stated, not measured


MOST_NS = 1e9  # of a coefficient
COEFFICIENTS = tuple(f.name for f in dataclasses.fields(DeviceProfile) if f.name.startswith("per_"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    budget: str = "16 ms"  # "16 ms", "300 calls" or "200000 triangles"
    device: str = "reference"  # device profile: what drawing costs
    device_profile: DeviceProfile | None = None  # its figures; None: `device` is a preset
    seed: int = 0  # [0, 2**63)
    scene: SceneSettings = field(default_factory=SceneSettings)
    camera: CameraSettings = field(default_factory=CameraSettings)
    view_space: ViewSpaceSettings = field(default_factory=ViewSpaceSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)
    detail: DetailSettings = field(default_factory=DetailSettings)
    visibility: VisibilitySettings = field(default_factory=VisibilitySettings)
    placement: PlacementSettings = field(default_factory=PlacementSettings)
    proof: ProofSettings = field(default_factory=ProofSettings)
    bake: BakeSettings = field(default_factory=BakeSettings)


Unit = Literal["ns", "calls", "triangles"]


@dataclass(frozen=True, slots=True)
class Budget:
    """What a frame may cost. `amount` is an integer in `unit`; "16 ms" is 16,000,000 ns."""

    unit: Unit
    amount: int


def parse_budget(text: str) -> Budget:
    """Return the budget that "16 ms", "300 calls" or "200000 triangles" names. Raises SettingsInvalid."""
    match = re.fullmatch(r"\s*([0-9][0-9_]*(?:\.[0-9]+)?)\s*(ms|calls?|triangles?)\s*", text)
    if not match:
        raise SettingsInvalid("budget", f'{text!r} is not of the form "16 ms", "300 calls" or "200000 triangles"')
    # Exact: in floats 16.67 ms is no whole number of nanoseconds. What is longer than 40 digits is no amount.
    amount, word = Fraction(match[1].replace("_", "") if len(match[1]) <= 40 else "1e40"), match[2]
    if word == "ms":
        unit, amount = "ns", amount * 1_000_000
    else:
        unit = "calls" if word.startswith("call") else "triangles"
    if amount.denominator != 1 or amount > 2**53:
        raise SettingsInvalid("budget", f"{text!r} is not a whole number of {unit}, or too large")
    return Budget(typing.cast(Unit, unit), int(amount))


def from_mapping(values: Mapping[str, Any]) -> Settings:
    """Return checked Settings from nested mappings (a TOML file, a JSON body). Raises SettingsInvalid."""
    settings = _build(Settings, values, "")
    check(settings)
    return settings


def to_mapping(settings: Settings) -> dict[str, Any]:
    """Return plain nested dicts and lists: JSON-able, the inverse of `from_mapping`."""
    return typing.cast(dict[str, Any], _plain(settings))


def check(settings: Settings) -> None:
    """Refuse every value out of range. Raises SettingsInvalid with the dotted key."""
    s = settings

    def need(condition: bool, key: str, why: str) -> None:
        if not condition:
            raise SettingsInvalid(key, why)

    parse_budget(s.budget)
    need(0 <= s.seed < 2**63, "seed", "must be in [0, 2**63)")
    need(len(s.device) <= 255, "device", "must be at most 255 characters")
    if s.device_profile is not None:
        fit = s.device_profile.fit
        need(fit is None or 0 <= fit.samples <= 10**9, "device_profile.fit.samples", "must be in 0..10**9")
        for key in COEFFICIENTS:
            ns = getattr(s.device_profile, key)
            need(0 <= ns <= MOST_NS, f"device_profile.{key}", "must be in [0, 1e9] nanoseconds")
    unit_m = s.scene.unit_m
    need(unit_m is None or (1e-9 <= unit_m <= 1e9), "scene.unit_m", "must be in [1e-9, 1e9]")
    need(16 <= s.scene.split_triangles <= 1_000_000, "scene.split_triangles", "must be in 16..1,000,000")
    need(0 < s.camera.fov_deg <= 150, "camera.fov_deg", "must be in (0, 150] degrees")
    for key in ("width", "height"):
        need(16 <= getattr(s.camera, key) <= 16384, f"camera.{key}", "must be in 16..16384 pixels")
    need(s.view_space.interval_deg in (90.0, 45.0, 22.5, 11.25, 5.625), "view_space.interval_deg",
         "must be 90, 45, 22.5, 11.25 or 5.625 degrees")  # fmt: skip
    cell_m = s.view_space.cell_m
    need(cell_m is None or (math.isfinite(cell_m) and cell_m > 0), "view_space.cell_m", "must be a positive length")
    if s.view_space.boxes is not None:
        need(len(s.view_space.boxes) > 0, "view_space.boxes", "must hold at least one box, or be left out")
        for i, (low, high) in enumerate(s.view_space.boxes):
            finite = all(math.isfinite(x) for x in (*low, *high))
            need(finite and all(a <= b for a, b in zip(low, high, strict=True)), f"view_space.boxes[{i}]",
                 "must be two finite corners, the lower one first")  # fmt: skip
    need(0 < s.visibility.missed_ppm <= 1e6, "visibility.missed_ppm", "must be in (0, 1e6] pixels a million")
    need(1000 <= s.visibility.rays <= 10**9, "visibility.rays", "must be in 1000..10**9 rays a cell")
    need(0 < s.quality.pixel_error <= 64, "quality.pixel_error", "must be in (0, 64] pixels")
    need(1 <= s.proof.pairs <= 10**6, "proof.pairs", "must be in 1..10**6")
    need(1 <= s.proof.views <= 1000, "proof.views", "must be in 1..1000")
    need(0.5 <= s.proof.confidence <= 0.9999, "proof.confidence", "must be in [0.5, 0.9999]")
    need(0 < s.placement.far_m <= 1e9, "placement.far_m", "must be in (0, 1e9] metres")
    need(0.001 <= s.placement.density <= 1000, "placement.density", "must be in [0.001, 1000]")
    need(1 <= s.placement.hopeless_slack <= 10, "placement.hopeless_slack", "must be in [1, 10]")
    need(1 <= s.placement.regions <= 64, "placement.regions", "must be in 1..64")
    limit_s = s.placement.time_limit_s
    base = s.placement.base
    need(
        base is None or re.fullmatch("[0-9a-f]{64}", base) is not None,
        "placement.base",
        "must be a SHA-256 in hex digits",
    )
    need(base is None or s.placement.candidates != "environment", "placement.base", "environment maps are placed whole")
    need(limit_s is None or limit_s > 0, "placement.time_limit_s", "must be a positive number of seconds")


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return value


def _build(cls: type, values: Any, prefix: str) -> Any:
    if not isinstance(values, Mapping):
        raise SettingsInvalid(prefix.rstrip(".") or "settings", "must be a table of settings")
    hints = typing.get_type_hints(cls)
    unknown = sorted(set(map(str, values)) - set(hints))
    if unknown:
        raise SettingsInvalid(prefix + unknown[0], f"unknown setting; known here: {', '.join(sorted(hints))}")
    for f in dataclasses.fields(cls):
        if f.name not in values and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING:
            raise SettingsInvalid(prefix + f.name, "is missing")
    return cls(**{name: _convert(hints[name], values[name], prefix + name) for name in hints if name in values})


def _convert(hint: Any, value: Any, key: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, key + ".")
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return None
        (inner,) = (a for a in arguments if a is not type(None))
        return _convert(inner, value, key)
    if origin is Literal:
        if value not in arguments:
            raise SettingsInvalid(key, f"must be one of {', '.join(map(str, arguments))}, not {value!r}")
        return value
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise SettingsInvalid(key, "must be a list")
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return tuple(_convert(arguments[0], v, f"{key}[{i}]") for i, v in enumerate(value))
        if len(value) != len(arguments):
            raise SettingsInvalid(key, f"must have {len(arguments)} entries")
        return tuple(_convert(a, v, f"{key}[{i}]") for i, (a, v) in enumerate(zip(arguments, value, strict=True)))
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise SettingsInvalid(key, "must be finite")
        return float(value)
    if hint is bool and isinstance(value, bool):
        return value
    if hint is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if hint is str and isinstance(value, str):
        return value
    raise SettingsInvalid(key, f"must be {getattr(hint, '__name__', hint)}, not {value!r}")
