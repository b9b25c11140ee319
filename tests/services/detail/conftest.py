import dataclasses

import pytest
from curved import curved_level
from farfield.detail.build import build_levels, merge, plan_shards
from farfield.scene.read import read_scene
from farfield.settings import CameraSettings, DetailSettings, QualitySettings, Settings, ViewSpaceSettings


@pytest.fixture(scope="session")
def options() -> Settings:
    return Settings(
        budget="12000 triangles", camera=CameraSettings(fov_deg=45.0, width=640, height=360),
        view_space=ViewSpaceSettings(cell_m=8.0, boxes=(((-12.0, 1.0, -8.0), (12.0, 2.5, 8.0)),)),
        detail=DetailSettings(mode="on"),
    )  # fmt: skip


@pytest.fixture(scope="session")
def curved(tmp_path_factory, options):
    """The curved level as a Scene."""
    path = tmp_path_factory.mktemp("curved") / "level.glb"
    path.write_bytes(curved_level())
    return read_scene(path, settings=options)


@pytest.fixture(scope="session")
def levels_at(curved, options):
    """Return the levels of the curved level for a pixel error and where it is measured, and the settings."""
    known = {}

    def build(pixel_error=1.0, pixels_at="centre"):
        key = (pixel_error, pixels_at)
        if key not in known:
            changed = dataclasses.replace(
                options, quality=QualitySettings(pixel_error=pixel_error, pixels_at=pixels_at)
            )
            parts = [build_levels(curved, settings=changed, meshes=s) for s in plan_shards(curved)]
            known[key] = merge(parts, curved, settings=changed), changed
        return known[key]

    return build
