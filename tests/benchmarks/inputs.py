"""What is measured on: a level with settings, taken through the stages as far as a benchmark asks."""

import dataclasses
import hashlib
import tomllib
from functools import cached_property
from pathlib import Path

import numpy as np
from cutout import city_cutout
from farfield.bake.bake import bake_batch, merge, plan_batches
from farfield.bake.model import BakedLayers
from farfield.candidates.generate import generate, plan_shards
from farfield.candidates.generate import merge as merge_candidates
from farfield.candidates.model import Candidates
from farfield.geometry.cells import CellTree, build_cells
from farfield.hierarchy.build import build_hierarchy
from farfield.hierarchy.model import Hierarchy
from farfield.placement.greedy import place
from farfield.placement.model import Placement
from farfield.placement.repair import repair
from farfield.placementdb.write import build_files
from farfield.rendertime.cost import build_cost_model
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import CameraSettings, Settings, ViewSpaceSettings, from_mapping
from farfield.viewspace.model import ProblemViews
from farfield.viewspace.split import find_problem_views
from farfield.visibility.model import VisibleSets
from towns import town

OFF = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))


class Level:
    """A scene and each stage's output, made when first asked for; `run_*` does a stage anew."""

    def __init__(self, name: str, scene: Scene, settings: Settings) -> None:
        self.name, self.scene, self.settings = name, scene, settings

    @cached_property
    def hierarchy(self) -> Hierarchy:
        return build_hierarchy(self.scene)

    @cached_property
    def model(self) -> CostModel:
        return build_cost_model(self.scene, settings=self.settings)

    @cached_property
    def cells(self) -> CellTree:
        return build_cells(self.scene.view_boxes, self.scene.cell_m)

    @cached_property
    def views(self) -> ProblemViews:
        return self.run_viewspace()

    @cached_property
    def candidates(self) -> Candidates:
        return self.run_candidates()

    @cached_property
    def placement(self) -> Placement:
        return self.run_placement()

    @cached_property
    def baked(self) -> BakedLayers:
        return merge([self.run_bake("numba", batch) for batch in plan_batches(self.placement)])

    @cached_property
    def repaired(self) -> Placement:
        b = self.baked
        return repair(
            self.placement, self.hierarchy, self.model, self.cells, self.views, self.candidates,
            measured_bytes=b.bytes, measured_cost=b.cost, layers=np.diff(b.layer_row).astype(np.int32),
        )  # fmt: skip

    @cached_property
    def glb(self) -> bytes:
        return write_glb(self.scene)

    def run_viewspace(self) -> ProblemViews:
        return find_problem_views(self.scene, self.hierarchy, self.model, OFF, settings=self.settings, node=0)

    def run_candidates(self) -> Candidates:
        given = self.scene, self.hierarchy, self.model, self.cells, self.views
        return merge_candidates(
            [generate(*given, settings=self.settings, nodes=nodes) for nodes in plan_shards(self.hierarchy)]
        )

    def run_placement(self) -> Placement:
        return place(
            self.scene, self.hierarchy, self.model, self.cells, self.views, self.candidates, settings=self.settings
        )

    def run_bake(self, renderer: str, impostors: tuple[int, int]) -> BakedLayers:
        return bake_batch(
            self.scene, self.hierarchy, self.model, self.placement, settings=self.settings, impostors=impostors,
            renderer=renderer,
        )  # fmt: skip

    def run_placementdb(self) -> dict[str, bytes]:
        return build_files(
            self.scene, self.hierarchy, self.model, self.cells, OFF, self.views, self.repaired, self.baked,
            settings=self.settings, digests={"scene.glb": hashlib.sha256(self.glb).hexdigest()}, threads=1,
        )  # fmt: skip

    def save(self, folder: Path) -> Path:
        """Write what `farfield place` would: scene.glb and placement/."""
        for name, content in {"scene.glb": self.glb, **{f"placement/{n}": c for n, c in self.files.items()}}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder

    @cached_property
    def files(self) -> dict[str, bytes]:
        return self.run_placementdb()


def cutout_level(height: int = 720) -> Level:
    """Return the demo city's cut-out, its camera `height` pixels high. Skips where its scene files are missing."""
    glb, toml = city_cutout()
    settings = from_mapping(tomllib.loads(toml.read_text(encoding="utf-8")))
    camera = CameraSettings(fov_deg=settings.camera.fov_deg, width=height * 16 // 9, height=height)
    settings = dataclasses.replace(settings, camera=camera)
    return Level(f"cut-out {camera.width}x{height}", read_scene(glb, settings=settings), settings)


def town_level(n: int, *, budget: str | None = None, view_m: float = 64.0, interval_deg: float = 11.25) -> Level:
    """Return a town of n houses; its budget is a call for every fourth house unless given."""
    settings = Settings(budget=budget or f"{n // 4} calls", view_space=ViewSpaceSettings(interval_deg=interval_deg))
    return Level(f"town({n})", town(n, view_m=view_m), settings)
