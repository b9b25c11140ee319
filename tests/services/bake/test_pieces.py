"""Rectangles of a layer: nothing is lost, neighbours share the line they are cut along, the first cut is the best one."""

import numpy as np
from farfield.bake.pieces import ALIGN, MOST, ROW_BYTES, rectangles
from farfield.impostor.weight import TEXEL_BYTES
from farfield.placementdb.layout import ALIGN_TEXELS


def weight(rectangle):
    x0, x1, y0, y1 = rectangle
    wide, high = x1 - x0, y1 - y0
    up = lambda n: -(-n // ALIGN) * ALIGN  # noqa: E731
    return TEXEL_BYTES * (up(wide) * up(high) + wide * high) // 2


def tight(alpha, x0, x1, y0, y1):
    j, i = np.nonzero(alpha[y0:y1, x0:x1])
    return (x0 + i.min(), x0 + i.max() + 1, y0 + j.min(), y0 + j.max() + 1) if len(i) else None


def best_pair(alpha, r):
    """Every cut there is: the two tight sides that weigh least, and what that saves."""
    x0, x1, y0, y1 = r
    found = [((x0, c + 1, y0, y1), (c, x1, y0, y1)) for c in range(x0 + 1, x1 - 1)]
    found += [((x0, x1, y0, c + 1), (x0, x1, c, y1)) for c in range(y0 + 1, y1 - 1)]
    sides = [(tight(alpha, *a), tight(alpha, *b)) for a, b in found]
    return max((weight(r) - ROW_BYTES - weight(a) - weight(b) for a, b in sides if a and b), default=0)


def layers(rng, n):
    for _ in range(n):
        alpha = np.zeros(rng.integers(1, 70, 2), np.uint8)
        for _ in range(rng.integers(1, 5)):
            j, i = (rng.integers(0, s) for s in alpha.shape)
            alpha[j : j + rng.integers(1, 25), i : i + rng.integers(1, 25)] = 7
        yield alpha


def test_alignment_is_that_of_the_pages():
    assert ALIGN == ALIGN_TEXELS


def test_everything_set_is_in_some_rectangle_and_they_weigh_less():
    for alpha in layers(np.random.default_rng(0), 400):
        found = rectangles(alpha)
        assert 1 <= len(found) <= MOST
        seen = np.zeros(alpha.shape, int)
        for x0, x1, y0, y1 in found:
            assert tight(alpha, x0, x1, y0, y1) == (x0, x1, y0, y1)
            seen[y0:y1, x0:x1] += 1
        assert (seen[alpha > 0] > 0).all()
        one = rectangles(alpha, 1)
        assert len(one) == 1
        total = sum(map(weight, found)) + ROW_BYTES * (len(found) - 1)
        assert total <= weight(one[0])


def test_texels_that_touch_share_a_rectangle():
    """So no gap can open between two rectangles, whatever the rounding of their corners."""
    cut = 0
    for alpha in layers(np.random.default_rng(1), 300):
        found = rectangles(alpha)
        cut += len(found) > 1
        inside = np.array([[(x0 <= i) & (i < x1) & (y0 <= j) & (j < y1) for x0, x1, y0, y1 in found]
                           for j, i in np.argwhere(alpha)])  # fmt: skip
        at = {tuple(p): row for p, row in zip(np.argwhere(alpha).tolist(), inside, strict=True)}
        for (j, i), row in at.items():
            for other in ((j, i + 1), (j + 1, i)):
                if other in at:
                    assert (row & at[other]).any(), (j, i, found)
    assert cut > 30


def test_the_first_cut_saves_as_much_as_the_best_of_all():
    for alpha in layers(np.random.default_rng(2), 250):
        (whole,), pair = rectangles(alpha, 1), rectangles(alpha, 2)
        best = best_pair(alpha, whole)
        saved = weight(whole) - sum(map(weight, pair)) - ROW_BYTES * (len(pair) - 1)
        assert saved == max(best, 0)
