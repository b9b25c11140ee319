"""Shares and mean colours of texels: against every point of every piece, against true areas, and for seams."""

import dataclasses

import numpy as np
import pytest
from farfield.bake.area import compose, layer_starts, sample
from farfield.bake.bake import _surface, bake_batch
from farfield.bake.beside import mark_beside
from farfield.bake.clip import bound, cut, gather
from farfield.bake.coverage import record
from farfield.bake.shade import DECODE, encode_srgb, light
from farfield.bake.sheets import lay_out
from farfield.bake.textures import decode
from farfield.candidates.model import BOX
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.plan import plan_layers
from farfield.rendertime.cost import build_cost_model
from farfield.settings import from_mapping
from naive import area as naive
from naive import bake as naive_bake
from panels import Panel, box_cell, chosen, panel_scene

SETTINGS = from_mapping({"camera": {"width": 160, "height": 90}})
CELL = box_cell((-2, 1, -2), (2, 3, 2))


def steps(scene, objects=None):
    """Return what the steps of a bake hand to each other for these objects (all), seen from CELL."""
    a, b = objects or (0, scene.n_objects)
    box = np.stack([scene.object_box[a:b, 0].min(0), scene.object_box[a:b, 1].max(0)])
    plan = plan_layers(BOX, CELL, box, settings=SETTINGS)
    surface = _surface(scene, (a, b), decode(scene, np.zeros(0, int)))
    sources = gather(scene, (a, b), plan, kind=BOX, view_cell=CELL)
    pieces = cut(sources, plan)
    slabs = bound(pieces, plan)
    start = layer_starts(slabs)
    rgba, points = np.zeros((int(start[-1]), 4), np.uint8), np.zeros(int(start[-1]), np.uint16)
    for layers, size in lay_out(slabs):
        sheet = record(sources, pieces, slabs, surface, layers, size)
        sample(sources, pieces, slabs, surface, layers, sheet, start, rgba, points)
    beside = mark_beside(scene, (a, b), box, plan, slabs, start)
    return plan, surface, sources, pieces, slabs, start, rgba, points, beside


def random_panels(rng, n):
    spots = rng.uniform((-9, 0, -44), (9, 6, -24), (n, 3))
    return [Panel(low=tuple(p), u=tuple(rng.normal(size=3) * 2), v=tuple(rng.normal(size=3) * 2)) for p in spots]


@pytest.mark.parametrize("seed", range(4))
def test_points_and_mean_colours_are_those_of_every_piece_at_every_point(seed):
    rng = np.random.default_rng(seed)
    panels = [dataclasses.replace(p, material=m % 2) for m, p in enumerate(random_panels(rng, 5))]
    colors = [(0.7, 0.5, 0.2, 1), (0.1, 0.3, 0.6, 1)]
    scene = panel_scene(panels, base_color=colors)
    _, surface, sources, pieces, slabs, start, rgba, points, _ = steps(scene)
    shown = _colors(surface, sources, np.array(colors)[:, :3])
    checked = 0
    for k in range(len(slabs.size)):
        (x0, y0), (w, h) = slabs.low[k].tolist(), slabs.size[k].tolist()
        texels = [(x, y) for y in range(h) for x in range(w) if rgba[start[k] + y * w + x, 3]]
        for n in rng.permutation(len(texels))[:30]:
            x, y = texels[n]
            t = start[k] + y * w + x
            found = naive.owners(sources, pieces, k, x0 + x, y0 + y)
            assert points[t] == sum(1 << b for b, f in enumerate(found) if f >= 0)
            own = [pieces.source[f] for f in found if f >= 0]
            if own:
                expected = encode_srgb(shown[own].mean(0)).astype(int)
                assert np.abs(rgba[t, :3].astype(int) - expected).max() <= 1 + 6 * (_tie(sources, pieces, found))
                checked += 1
    assert checked > 30


def _colors(surface, sources, base):
    normal = surface.normal[sources.vertex[:, 0]].astype(float)
    turned = np.einsum("nab,nb->na", surface.turn[sources.object], normal)
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    turned[sources.away] *= -1
    return np.clip(base[sources.material] * light(turned), 0, 1)


def _tie(sources, pieces, found):
    """Whether two surfaces meet within the texel, so that rounding decides who owns a point on their line."""
    return len({int(sources.object[pieces.source[f]]) for f in found if f >= 0}) > 1


@pytest.mark.parametrize("seed", range(4))
def test_texels_are_composed_as_in_words(seed):
    rng = np.random.default_rng(100 + seed)
    scene = panel_scene(random_panels(rng, 7))
    _, surface, _, _, slabs, start, rgba, points, beside = steps(scene)
    beside = (rng.random(len(beside)) < 0.1).astype(np.uint8)
    found = compose(slabs, surface, start, rgba, points, beside)
    expected = naive.composed(slabs, start, rgba, points, beside, DECODE, encode_srgb)
    np.testing.assert_array_equal(found[:, 3], expected[:, 3])
    assert np.abs(found[:, :3].astype(int) - expected[:, :3]).max() <= 1
    assert len(np.unique((found[found[:, 3] > 0, 3] - 1) % 4)) == 4


def test_a_silhouette_is_no_fatter_than_its_surface():
    """The shares of an upright panel's texels add up to its area; recorded squares would be a tenth more."""
    panel = Panel(low=(-3.03, 0.4, -30), u=(5.9, 0, 0), v=(0.7, 4.9, 0))
    plan, surface, _, pieces, slabs, start, rgba, points, beside = steps(panel_scene([panel]))
    texels = compose(slabs, surface, start, rgba, points, beside)
    share = np.where(texels[:, 3] > 0, (texels[:, 3].astype(int) - 1) % 4 + 1, 0).sum() / 4
    corners = pieces.snapped.reshape(-1, 3, 2) / 256
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2
    assert len(plan.plane) == 1
    assert share == pytest.approx(area, rel=0.02)
    assert (texels[:, 3] > 0).sum() > 1.08 * area


def test_a_sliver_does_not_decide_a_colour():
    """A dark strip a twentieth of a texel high on a bright wall: what it darkens is a twentieth."""
    wall = Panel(low=(-4, 0, -30), u=(8, 0, 0), v=(0, 4, 0))
    strip = Panel(low=(-4, 4.0, -30), u=(8, 0, 0), v=(0, 0.02, 0), material=1)
    scene = panel_scene([wall, strip], base_color=[(0.8, 0.8, 0.8, 1), (0, 0, 0, 1)])
    _, surface, _, _, slabs, start, rgba, points, beside = steps(scene)
    texels = compose(slabs, surface, start, rgba, points, beside)
    w, h = slabs.size[0]
    rows = texels[: w * h].reshape(h, w, 4)[:, 2:-2]
    bright = rows[h // 2, :, 0].min()
    touched = rows[(rows[..., 3] > 0).any(1)][-2:]
    assert (touched[..., 0] >= 0.8 * bright).all()


def seam(texels, slabs, start, plan, line):
    """Return the alphas of all texels, in any layer, that hold a point of a line of the scene (n,3)."""
    rel = line - plan.eye
    z = -(rel @ plan.back)
    slope = np.stack([rel @ plan.right, rel @ plan.up], -1) / z[:, None]
    at = (slope - plan.slope0) / plan.texel
    layer = np.searchsorted(np.asarray(plan.far), z)
    out = []
    for (i, j), k, p in zip(np.floor(at).astype(int), layer, at, strict=True):
        if np.abs(p - np.round(p)).min() < 1 / 100:
            continue  # snapping may move it into the next
        x, y = i - slabs.low[k, 0], j - slabs.low[k, 1]
        assert 0 <= x < slabs.size[k, 0] and 0 <= y < slabs.size[k, 1]
        out.append(int(texels[start[k] + y * slabs.size[k, 0] + x, 3]))
    return np.array(out)


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
def test_what_lies_side_by_side_in_two_impostors_leaves_no_seam(turn):
    """One plane cut into two objects along a crooked line: both draw the texels of the line in full."""
    a, b = np.array([-6.0, 0.3, -26]), np.array([6.0, 0.9, -26 - 20 * turn])
    left = Panel(low=tuple(a), u=tuple(b - a), v=(0.9, 4.4, -1.0))
    right = Panel(low=tuple(a), u=tuple(b - a), v=(-1.1, -4.0, 1.0))
    scene = panel_scene([left, right])
    line = a + np.linspace(0.01, 0.99, 500)[:, None] * (b - a)
    for k in range(2):
        plan, surface, _, _, slabs, start, rgba, points, beside = steps(scene, (k, k + 1))
        texels = compose(slabs, surface, start, rgba, points, beside)
        alphas = seam(texels, slabs, start, plan, line)
        assert len(alphas) > 200
        assert (alphas > 0).all()
        assert (alphas % 4 == 0).all()
        alone = compose(slabs, surface, start, rgba, points, np.zeros_like(beside))
        assert (seam(alone, slabs, start, plan, line) % 4 != 0).any(), "without the marks there is a seam to see"


def test_a_surface_that_goes_on_in_the_next_layer_is_drawn_in_full():
    slope = Panel(low=(-10, 0, -30), u=(20, 0, 0), v=(1, 6, -60))
    scene = panel_scene([slope])
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=SETTINGS)
    one = bake_batch(scene, hierarchy, model, chosen([0], BOX, CELL), settings=SETTINGS, impostors=(0, 1),
                     renderer="numba")  # fmt: skip
    assert len(one.plane) > 3
    shared = 0
    grids = np.zeros((len(one.plane), *one.resolution[0][::-1]))
    for k in range(len(one.plane)):
        t, (x, y) = naive_bake.shares(one, k), one.tile_at[k]
        grids[k, y : y + t.shape[0], x : x + t.shape[1]] = t
    for k in range(len(one.plane) - 1):
        both = (grids[k] > 0) & (grids[k + 1] > 0)
        shared += int(both.sum())
        assert (grids[k][both] == 1).all()
        assert (grids[k + 1][both] == 1).all()
    assert shared > 100


def test_surfaces_that_end_in_front_of_each_other_in_distant_layers_let_nothing_through():
    """A floating wall whose lower edge crosses the upper edge of a bank 20 m behind it: from the eye they overlap or
    meet, though nothing adjoins. Their shares know no place in the texel, so texels where both end are drawn in full."""
    wall = Panel(low=(-6, 2.0, -26), u=(12, 0, 0), v=(0, 3, 0))
    edge = [(2.0 + 0.3 * side - 2) * 46 / 26 + 2 for side in (-1, 1)]  # as high as the wall's from about the eye
    bank = Panel(low=(-12, edge[0] - 4, -46), u=(24, edge[1] - edge[0], 0), v=(0, 4, 0))
    _, surface, _, _, slabs, start, rgba, points, beside = steps(panel_scene([wall, bank]))
    assert not beside.any()
    texels = compose(slabs, surface, start, rgba, points, beside)
    held = [k for k in range(len(slabs.size)) if slabs.size[k, 0]]
    assert len(held) == 2
    assert held[1] - held[0] > 1, "the layers do not adjoin"
    size = (slabs.low[held] + slabs.size[held]).max(0)
    ends, share = (np.zeros((2, *size[::-1]), t) for t in (bool, int))
    for n, k in enumerate(held):
        (x, y), (w, h) = slabs.low[k], slabs.size[k]
        part = slice(start[k], start[k] + w * h)
        there = texels[part, 3] > 0
        ends[n, y : y + h, x : x + w] = (there & (points[part] != 0xFFFF)).reshape(h, w)
        share[n, y : y + h, x : x + w] = np.where(there, (texels[part, 3].astype(int) - 1) % 4 + 1, 0).reshape(h, w)
    both = ends.all(0)
    assert both.sum() > 5
    assert (share[:, both] == 4).all()
    near = np.lib.stride_tricks.sliding_window_view(np.pad(ends, ((0, 0), (1, 1), (1, 1))), (3, 3), (1, 2)).any((3, 4))
    for n in range(2):
        assert (share[n][ends[n] & near[1 - n]] == 4).all(), "layers shift by less than a texel against each other"
        assert (share[n][ends[n] & ~near[1 - n]] < 4).any(), "a silhouette before nothing keeps its share"
