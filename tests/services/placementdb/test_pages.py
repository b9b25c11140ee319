"""Packing never overlaps, mip levels keep coverage, cut layers keep every texel and meet without a crack."""

import io

import numpy as np
import pytest
import rectpack
from farfield.placementdb.kernels import max_rects
from farfield.placementdb.layers import clip, cut_layers, halved
from farfield.placementdb.layout import ALIGN_TEXELS, LEVELS, PAGE_HEIGHT, PAGE_TEXELS, PAGE_WIDTH
from farfield.placementdb.pack import pack_blocks
from farfield.placementdb.pages import encode, page_image
from hypothesis import given, settings
from hypothesis import strategies as st
from naive.placementdb import coarser, to_linear
from PIL import Image
from placements import TILES, made_up, octagon, texels


@given(st.lists(st.tuples(st.integers(1, PAGE_TEXELS), st.integers(1, 300), st.integers(0, 7)), max_size=60), st.data())
@settings(max_examples=25, deadline=None)
def test_blocks_never_overlap_and_all_lie_on_pages(blocks, data) -> None:
    shown = [sorted(data.draw(st.sets(st.integers(0, 9), max_size=4))) for _ in range(8)]
    row, cell = _csr(shown)
    size, owner = (
        np.array([b[:2] for b in blocks], dtype=np.int64).reshape(-1, 2),
        np.array([b[2] for b in blocks], dtype=np.int64),
    )
    page, at = pack_blocks(size, owner, row, cell)
    assert (at % ALIGN_TEXELS == 0).all()
    assert (at + size <= PAGE_TEXELS).all()
    assert (page >= 0).all()
    for k in range(int(page.max(initial=-1)) + 1):
        used = np.zeros((PAGE_TEXELS // 8, PAGE_TEXELS // 8), dtype=bool)  # in units of the coarsest texel
        assert (page == k).any()
        for b in np.flatnonzero(page == k):
            (x, y), (w, h) = at[b] // 8, -(-size[b] // 8)
            assert not used[y : y + h, x : x + w].any()
            used[y : y + h, x : x + w] = True


def test_what_the_same_cells_show_lies_together_and_dense() -> None:
    """Twelve places of five cells each: impostors of one place, some of two, a few of all, in a shuffled order."""
    rng = np.random.default_rng(0)
    shown: list[list[int]] = []
    for i in range(600):
        place, kind = int(rng.integers(12)), i % 20
        places = range(12) if kind == 0 else (place, (place + 1) % 12) if kind < 4 else (place,)
        shown.append(sorted(int(5 * p + c) for p in places for c in rng.choice(5, rng.integers(3, 6), replace=False)))
    owner = np.repeat(np.arange(600), 2)
    size = rng.integers(8, 150, (1200, 2))
    page, _ = pack_blocks(size, owner, *_csr(shown))
    area = (-(-size // 8) * 8).prod(1)
    n_pages = int(page.max()) + 1
    assert n_pages <= np.ceil(area.sum() / PAGE_TEXELS**2 / 0.95) + 1
    touched, least = [], []
    for c in range(60):
        here = np.isin(owner, [i for i, cells in enumerate(shown) if c in cells])
        touched.append(len(np.unique(page[here])))
        least.append(np.ceil(area[here].sum() / PAGE_TEXELS**2))
    assert np.mean(touched) <= 4 * np.mean(least)
    by_number, _ = pack_blocks(size, owner, np.arange(601), np.zeros(600, dtype=np.int64))  # all as if of one cell
    as_they_come = np.mean(
        [len(np.unique(by_number[np.isin(owner, [i for i in range(600) if c in shown[i]])])) for c in range(60)]
    )
    assert np.mean(touched) < as_they_come / 1.5


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 40)), min_size=1, max_size=150), st.integers(30, 64))
@settings(max_examples=40, deadline=None)
def test_blocks_lie_where_the_library_puts_them(blocks, side) -> None:
    library = rectpack.newPacker(
        mode=rectpack.PackingMode.Offline, bin_algo=rectpack.PackingBin.BFF, pack_algo=rectpack.MaxRectsBssf,
        sort_algo=rectpack.SORT_NONE, rotation=False,
    )  # fmt: skip
    for b, (width, height) in enumerate(blocks):
        library.add_rect(width, height, rid=b)
    library.add_bin(side, side)
    library.pack()
    expected = np.full((len(blocks), 2), -1)
    for _, x, y, _, _, b in library.rect_list():
        expected[b] = x, y
    np.testing.assert_array_equal(max_rects(np.array(blocks, dtype=np.int64), side), expected)


def test_an_impostor_larger_than_a_page_fills_pages_of_its_own_and_harms_no_other() -> None:
    size = np.full((17 + 40, 2), 256)
    owner = np.concatenate([np.zeros(17, dtype=np.int64), 1 + np.arange(40)])
    page, _ = pack_blocks(size, owner, *_csr([[0], *([1 + i % 2] for i in range(40))]))
    assert int(page.max()) + 1 == 4
    assert len(np.unique(page[:17])) == 2


def _csr(lists: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    row = np.concatenate([[0], np.cumsum([len(x) for x in lists], dtype=np.int64)])
    return row, np.array([c for x in lists for c in x], dtype=np.int64)


def test_mip_levels_agree_with_texel_by_texel() -> None:
    blocks, x = [], 0
    for k, (w, h) in enumerate(TILES):
        blocks.append((x, 8 * k, texels(w, h, k)))
        x += -(-w // 8) * 8
    image = page_image(blocks)
    assert image.shape == (PAGE_HEIGHT, PAGE_WIDTH, 4)
    to_linear_table = np.array([to_linear(b) for b in range(256)])
    for level, (left, top, size) in enumerate(LEVELS):
        view = image[top : top + size, left : left + size]
        rest = view.copy()
        for x, y, tile in blocks:
            alpha, colour = coarser(tile, level)
            h, w = alpha.shape
            part = view[y >> level : (y >> level) + h, x >> level : (x >> level) + w]
            np.testing.assert_array_equal(part[..., 3], alpha)
            # The stored byte is the nearest: within half a step of sRGB (and 2^-16 of stored linear light).
            for side in (-0.5, 0.5):
                bound = np.array([to_linear(b + side) for b in range(256)])[part[..., :3]]
                assert (np.sign(side) * (bound - colour) >= -2e-5).all()
            assert np.abs(to_linear_table[part[..., :3]] - colour).max() < 0.006
            rest[y >> level : (y >> level) + h, x >> level : (x >> level) + w] = 0
        assert not rest.any()  # nothing outside the blocks


def test_a_covered_texel_stays_covered_at_every_level() -> None:
    rng = np.random.default_rng(3)
    tile = rng.integers(0, 256, (50, 70, 4), dtype=np.uint8)
    tile[..., 3] *= rng.random((50, 70)) < 0.02
    image = page_image([(8, 16, tile)])
    for level, (left, top, _) in enumerate(LEVELS):
        for j, i in np.argwhere(tile[..., 3]):
            assert image[top + ((16 + j) >> level), left + ((8 + i) >> level), 3] >= tile[j, i, 3]


def test_colours_under_alpha_0_survive_the_file() -> None:
    image = page_image([(0, 0, texels(64, 64, 1))])
    assert (image[..., 3] == 0).any()
    assert (image[image[..., 3] == 0][:, :3] > 0).any()
    decoded = Image.open(io.BytesIO(encode(image)))
    np.testing.assert_array_equal(np.asarray(decoded), image)
    assert "icc_profile" not in decoded.info


def test_a_wide_layer_is_cut_into_pieces_that_share_their_corners() -> None:
    made = made_up(seed=1)
    baked = made["baked"]
    pieces = cut_layers(baked, np.ones(len(baked.eye), dtype=bool))
    wide = [k for k in range(len(baked.tile)) if baked.tile_size[baked.tile[k], 0] > PAGE_TEXELS]
    assert wide
    assert (pieces.block_rect[:, 2:] <= PAGE_TEXELS).all()
    for k in wide:
        rows = np.flatnonzero(pieces.layer == k)
        assert len(set(pieces.block[rows])) == 2
        assert len(set(pieces.number[rows])) == 1
        corners = [
            {tuple(p) for p in pieces.position[pieces.corner_row[r] : pieces.corner_row[r + 1]].tolist()} for r in rows
        ]
        shared = set.intersection(*corners)
        if len(rows) == 2:
            assert len(shared) == 2
    # Every covered texel of every shown tile is in exactly one block of it.
    for tile in set(baked.tile.tolist()):
        seen = np.zeros(baked.tile_size[tile][::-1], dtype=int)
        for x, y, w, h in pieces.block_rect[pieces.block_tile == tile]:
            seen[y : y + h, x : x + w] += 1
        assert (seen == 1).all()


def area(polygon: list[tuple[float, float]]) -> float:
    x, y = np.array(polygon).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


@pytest.mark.parametrize("n", [3, 8, 9, 12, 40])
def test_halving_keeps_area_and_triangles(n: int) -> None:
    angle = 2 * np.pi * np.arange(n) / n
    polygon = list(zip(np.cos(angle).tolist(), np.sin(angle).tolist(), strict=True))
    parts = halved(polygon)
    assert all(3 <= len(p) <= 8 for p in parts)
    assert sum(len(p) - 2 for p in parts) == n - 2
    assert sum(map(area, parts)) == pytest.approx(area(polygon), rel=1e-12)


@given(st.floats(0, 10), st.integers(0, 1))
def test_the_two_sides_of_a_cut_share_their_corners_bit_for_bit(bound: float, axis: int) -> None:
    polygon = [tuple(p) for p in (octagon(0.1, 0.3, 9.7, 9.3) + 0.05).tolist()]
    low, high = clip(polygon, axis, bound, low=True), clip(polygon, axis, bound, low=False)
    on = [{p for p in side if p[axis] == bound} for side in (low, high)]
    if len(low) >= 3 and len(high) >= 3:
        assert on[0] == on[1]
        assert area(low) + area(high) == pytest.approx(area(polygon), rel=1e-12)


def test_equal_tiles_are_stored_once() -> None:
    made = made_up(seed=2, n_impostors=12, wide=False)
    pieces = cut_layers(made["baked"], np.ones(12, dtype=bool))
    assert len(pieces.block_tile) <= len(TILES) < len(pieces.layer)
