"""What a bake costs over the size of its grid and over its triangles, what it holds, and what cropping and sharing save."""

import numpy as np
import pytest
from benchmarks.measure import best_seconds, exponent
from benchmarks.stored import pages_of_cells
from farfield.bake.bake import bake_batch
from farfield.candidates.model import BOX
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.plan import plan_layers
from farfield.impostor.weight import impostor_bytes
from farfield.placementdb.read import Placement
from farfield.rendertime.cost import build_cost_model
from farfield.settings import from_mapping
from panels import box_cell, chosen
from towns import town

CELL = box_cell((-8.0, 1.0, -8.0), (8.0, 3.0, 8.0))
WIDTHS = (160, 320, 640)  # of the camera: texels go with its square
TRIANGLES = (12, 192, 3072)  # a house


def run(renderer, *, width=160, triangles=12):
    """Return (a function that bakes the farthest houses, texels, triangles)."""
    settings = from_mapping({"camera": {"width": width, "height": width * 9 // 16}})
    scene = town(100, triangles=triangles)
    hierarchy = build_hierarchy(scene)
    far = [c for c in np.flatnonzero(hierarchy.stop - hierarchy.start == 1)
           if np.abs(scene.object_box[hierarchy.start[c]]).max() > 40][:16]  # fmt: skip
    model = build_cost_model(scene, settings=settings)
    placement = chosen([int(c) for c in far], BOX, CELL)

    def bake():
        return bake_batch(
            scene, hierarchy, model, placement, settings=settings, impostors=(0, len(far)), renderer=renderer
        )

    return bake, bake().tile_data.size // 4, triangles * len(far)


@pytest.mark.parametrize("renderer", ["numba", "egl"])
@pytest.mark.parametrize("what", ["texels", "triangles"])
def test_bake_over_size(renderer, what, request, report):
    if renderer == "egl":
        request.getfixturevalue("gl")
    sizes, seconds = [], []
    for size in WIDTHS if what == "texels" else TRIANGLES:
        bake, texels, triangles = run(renderer, **{"width" if what == "texels" else "triangles": size})
        sizes.append(texels if what == "texels" else triangles)
        seconds.append(best_seconds(bake, most=3, within_s=2.0))
    each = ", ".join(f"{n:,}: {1e9 * s / n:,.0f}" for n, s in zip(sizes, seconds, strict=True))
    report(
        stage=f"bake {renderer}", work=f"ns a {what[:-1]} over {what}", input=each, seconds=seconds[-1],
        rate=sizes[-1] / seconds[-1], unit=f"{what}/s", exponent=exponent(sizes, seconds),
        sizes=f"{sizes[0]:,} .. {sizes[-1]:,} {what}",
    )  # fmt: skip
    assert exponent(sizes, seconds) < 1.2


def test_cropping_and_sharing_at_least_halve_the_bytes(cutout, report):
    """Full: every layer as the whole grid of its impostor. The measure counts 4 bytes a texel and the tables."""
    baked, placement, hierarchy = cutout.baked, cutout.placement, cutout.hierarchy
    full = 0
    for i, cluster in enumerate(placement.cluster):
        plan = plan_layers(
            int(placement.kind[i]), placement.view_cell[i], hierarchy.box[cluster], settings=cutout.settings
        )
        full += impostor_bytes(int(plan.resolution.astype(np.int64).prod()) * len(plan.plane), len(plan.plane))
    cropped = int(baked.bytes.sum())
    stored = cropped - 4 * int(baked.tile_size.astype(np.int64).prod(1)[baked.tile].sum()) + baked.tile_data.size
    report(
        stage="bake numba", work="bytes of full rectangles / cropped and shared",
        input=f"{cutout.name}, {full / 1e6:.1f} MB full, {cropped / 1e6:.1f} cropped, {stored / 1e6:.1f} shared",
        seconds=0.0, rate=full / stored, unit="x",
    )  # fmt: skip
    assert stored <= full / 2


def test_pages_that_a_cell_touches(coarse_cutout, tmp_path, report):
    placement = Placement.open(coarse_cutout.save(tmp_path))
    touched, least = pages_of_cells(placement)
    report(
        stage="placementdb", work="pages that a cell's views touch, mean and least",
        input=f"{coarse_cutout.name}, {len(touched)} cells, {len(placement.manifest['pages'])} pages, least {np.mean(least):.1f}",
        seconds=0.0, rate=float(np.mean(touched)), unit="pages",
    )  # fmt: skip
    assert np.mean(touched) <= 3 * np.mean(least) + 1
