"""Scene to placement: what runs on the processor alone."""

import numpy as np
import pytest
from benchmarks.inputs import Level, town_level
from benchmarks.measure import best_seconds, exponent, nbytes, twin_seconds
from cutout import city_cutout
from farfield.candidates.generate import generate
from farfield.geometry.camera import Camera
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.plan import plan_layers
from farfield.placement.antichain import subtree_end
from farfield.placement.choose import choose
from farfield.placement.prospects import find_prospects
from farfield.rendertime.cost import covered_pixels_bound
from farfield.scene import kernels as scene_kernels
from farfield.scene.read import read_scene
from naive import greedy as naive_greedy
from naive import hierarchy as naive_hierarchy
from naive import rendertime as naive_rendertime
from naive import scene as naive_scene
from naive import viewspace as naive_viewspace
from towns import town


@pytest.fixture(scope="module")
def towns() -> list[Level]:
    return [town_level(n) for n in (400, 800, 1600)]


def sizes_of(levels: list[Level]) -> str:
    return f"objects {levels[0].scene.n_objects}..{levels[-1].scene.n_objects}"


def test_scene(cutout, report):
    path, _ = city_cutout()
    corner = cutout.scene.position[cutout.scene.index[:2000]]
    position, index = corner.reshape(-1, 3), np.arange(3 * len(corner), dtype=np.int32).reshape(-1, 3)
    keep = np.empty(len(corner), dtype=bool)
    ours = best_seconds(lambda: scene_kernels.solid_triangles(position, index, keep))
    twin = twin_seconds(lambda: [naive_scene.has_area(c) for c in corner])
    seconds = best_seconds(lambda: read_scene(path, settings=cutout.settings))
    report(
        stage="scene", work="read and order a GLB", input=f"{cutout.name}, {len(cutout.scene.index)} triangles", seconds=seconds,
        rate=len(cutout.scene.index) / seconds, unit="triangles/s", times_naive=twin / ours,
        naive_input=f"area of {len(corner)} triangles", least_bytes=path.stat().st_size + nbytes(cutout.scene),
    )  # fmt: skip


def test_hierarchy(report):
    small = town(400)
    ours = best_seconds(lambda: build_hierarchy(small))
    twin = twin_seconds(lambda: naive_hierarchy.clusters(small.object_box, small.origin_m, small.cell_m))
    sizes = [4_000, 16_000, 64_000]
    scenes = [town(n) for n in sizes]
    seconds = [best_seconds(lambda s=s: build_hierarchy(s)) for s in scenes]
    report(
        stage="hierarchy", work="cluster all objects", input=f"town({sizes[-1]})", seconds=seconds[-1],
        rate=sizes[-1] / seconds[-1], unit="objects/s", times_naive=twin / ours, naive_input="400 objects",
        exponent=exponent(sizes, seconds), sizes=f"objects {sizes[0]}..{sizes[-1]}",
        least_bytes=nbytes(scenes[-1].object_box, build_hierarchy(scenes[-1])),
    )  # fmt: skip


def test_rendertime(cutout, report):
    model, boxes, cell_boxes = cutout.model, cutout.scene.object_box, cutout.cells.cell_box
    camera = Camera(fov_deg=model.fov_deg, width=model.width, height=model.height)
    ours = best_seconds(lambda: covered_pixels_bound(model, boxes, cell_boxes[0]))
    twin = twin_seconds(lambda: [naive_rendertime.pixels_bound(b, cell_boxes[0], camera) for b in boxes])
    many = [np.tile(boxes, (n, 1, 1)) for n in (1, 4, 16)]
    seconds = [best_seconds(lambda m=m: [covered_pixels_bound(model, m, c) for c in cell_boxes]) for m in many]
    report(
        stage="rendertime", work="bound covered pixels, object x cell", input=f"{cutout.name}, 16 times",
        seconds=seconds[-1], rate=len(many[-1]) * len(cell_boxes) / seconds[-1], unit="bounds/s",
        times_naive=twin / ours, naive_input=f"{len(boxes)} objects, 1 cell",
        exponent=exponent([len(m) for m in many], seconds), sizes=f"objects {len(many[0])}..{len(many[-1])}",
        least_bytes=len(cell_boxes) * (many[-1].nbytes + 8 * len(many[-1])),
    )  # fmt: skip


def test_viewspace(cutout, towns, report):
    small = town_level(50, budget="9 calls", view_m=20, interval_deg=22.5)
    camera = Camera(fov_deg=small.model.fov_deg, width=small.model.width, height=small.model.height)
    ours = best_seconds(small.run_viewspace)

    def twin() -> None:
        for box in small.cells.cell_box:
            naive_viewspace.problem_views(
                small.scene.object_box, small.model.object_fixed, box, visible=range(50), n=4, camera=camera,
                target=small.model.target,
            )  # fmt: skip

    times_naive = twin_seconds(twin) / ours
    seconds = [best_seconds(level.run_viewspace) for level in (*towns, cutout)]
    decided = cutout.scene.n_objects * cutout.cells.n_cells * 6 * 8 * 8
    report(
        stage="viewspace", work="find problem views", input=f"{cutout.name}, {len(cutout.views.cell)} found",
        seconds=seconds[-1], rate=decided / seconds[-1], unit="boxes x frusta/s", times_naive=times_naive,
        naive_input=f"50 objects, {small.cells.n_cells} cells, 96 frusta",
        exponent=exponent([level.scene.n_objects for level in towns], seconds[:-1]), sizes=sizes_of(towns),
        least_bytes=cutout.cells.n_cells * cutout.scene.object_box.nbytes + nbytes(cutout.views),
    )  # fmt: skip


def test_impostor(cutout, report):
    """No naive twin: a plan is a closed form, and its test measures errors, not time."""
    c = cutout.candidates
    chosen = range(0, len(c.cluster), max(1, len(c.cluster) // 1000))
    boxes = cutout.hierarchy.box[c.cluster]

    def plan() -> None:
        for i in chosen:
            plan_layers(int(c.kind[i]), c.view_cell[i], boxes[i], settings=cutout.settings)

    seconds = best_seconds(plan)
    report(
        stage="impostor", work="plan layers", input=f"{cutout.name}, {len(chosen)} candidates", seconds=seconds,
        rate=len(chosen) / seconds, unit="plans/s",
    )  # fmt: skip


def test_candidates(cutout, towns, report):
    from naive import candidates as naive_candidates

    small, nodes = town_level(90, budget="30 calls", view_m=32, interval_deg=90.0), (3, 20)
    given = small.hierarchy, small.model, small.cells, small.views
    ours = best_seconds(lambda: generate(small.scene, *given, settings=small.settings, nodes=nodes))
    twin = twin_seconds(lambda: naive_candidates.candidates(*given, small.settings, nodes))
    seconds = [best_seconds(level.run_candidates) for level in (*towns, cutout)]
    n = len(cutout.candidates.cluster)
    report(
        stage="candidates", work="fit view cells and impostors", input=f"{cutout.name}, {n} found",
        seconds=seconds[-1], rate=n / seconds[-1], unit="candidates/s", times_naive=twin / ours,
        naive_input=f"{nodes[1] - nodes[0]} clusters, {small.cells.n_cells} cells, {len(small.views.cell)} views",
        exponent=exponent([level.scene.n_objects for level in towns], seconds[:-1]), sizes=sizes_of(towns),
        least_bytes=nbytes(cutout.views, cutout.candidates),
    )  # fmt: skip


def test_placement(cutout, towns, report):
    small = town_level(90, budget="30 calls", view_m=32, interval_deg=90.0)
    h, c = small.hierarchy, small.candidates
    end = subtree_end(h.start, h.stop)
    target = find_prospects(h, small.model, small.views, c, end=end).target
    excess = np.maximum(small.views.cost - target, 0)
    ours = best_seconds(lambda: choose(c, excess=excess, end=end))
    twin = twin_seconds(lambda: naive_greedy.place(h, small.views, c, target))
    seconds = [best_seconds(level.run_placement) for level in (*towns, cutout)]
    n = len(cutout.candidates.cluster)
    report(
        stage="placement", work="choose, prune, bound, assign",
        input=f"{cutout.name}, {len(cutout.placement.cluster)} chosen", seconds=seconds[-1], rate=n / seconds[-1],
        unit="candidates/s", times_naive=twin / ours,
        naive_input=f"choosing from {len(c.cluster)} for {len(small.views.cell)} views",
        exponent=exponent([level.scene.n_objects for level in towns], seconds[:-1]), sizes=sizes_of(towns),
        least_bytes=nbytes(cutout.candidates, cutout.views, cutout.placement),
    )  # fmt: skip


def test_visibility(report):
    """No naive twin here: `tests/naive` holds the kernels to one, the ray caster is a library. Its peak is the bound."""
    from farfield.visibility.rays import rays_of
    from farfield.visibility.sample import Sampler

    level = town_level(1600)
    rays = rays_of(level.scene)

    def sample(most: int) -> Sampler:
        sampler = Sampler(level.scene, level.cells, int(level.cells.leaf[0]), seed=0, rays=rays)
        sampler.run(rays=most)
        return sampler

    sizes = [50_000, 100_000, 200_000]
    shot = [sample(n).n_rays for n in sizes]
    seconds = [best_seconds(lambda n=n: sample(n), most=3) for n in sizes]
    rng = np.random.default_rng(0)
    low, high = level.cells.cell_box[0]
    origin = rng.uniform(low, high, (2**17, 3))
    direction = rng.normal(size=(2**17, 3))
    direction /= np.sqrt((direction**2).sum(1))[:, None]
    peak = 2**17 / best_seconds(lambda: rays.first(origin, direction))
    report(
        stage="visibility", work="sample what a cell sees", input=f"town(1600), {shot[-1]:,} rays", seconds=seconds[-1],
        rate=shot[-1] / seconds[-1], unit="rays/s", exponent=exponent(shot, seconds), sizes=f"rays {shot[0]:,}..{shot[-1]:,}",
        bound_s=shot[-1] / peak, bound=f"random rays alone at {peak / 1e6:.1f}M/s",
    )  # fmt: skip
