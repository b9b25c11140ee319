"""Which texels a closed triangle touches, from first principles, in whole numbers; slow."""

Point = tuple[int, int]


def _side(a: Point, b: Point, p: Point) -> int:
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _between(a: Point, b: Point, p: Point) -> bool:
    return min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])


def segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Closed segments ab and cd, points allowed."""
    s = [_side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)]
    sign = [(v > 0) - (v < 0) for v in s]
    if sign[0] * sign[1] < 0 and sign[2] * sign[3] < 0:
        return True
    touching = [(a, b, c), (a, b, d), (c, d, a), (c, d, b)]
    return any(v == 0 and _between(p, q, r) for v, (p, q, r) in zip(s, touching, strict=True))


def in_triangle(t: list[Point], p: Point) -> bool:
    """p in the closed triangle t, which has area."""
    s = [_side(t[e], t[(e + 1) % 3], p) for e in range(3)]
    return all(v >= 0 for v in s) or all(v <= 0 for v in s)


def touches(t: list[Point], i: int, j: int) -> bool:
    """Do the closed triangle (1/256 texels) and the closed texel (i, j) have a point in common?

    They do iff a corner of the one lies in the other, or two edges meet.
    """
    x, y = 256 * i, 256 * j
    square = [(x, y), (x + 256, y), (x + 256, y + 256), (x, y + 256)]
    if any(x <= p[0] <= x + 256 and y <= p[1] <= y + 256 for p in t):
        return True
    if _side(*t) != 0 and any(in_triangle(t, p) for p in square):
        return True
    edges = [(t[e], t[(e + 1) % 3]) for e in range(3)]
    return any(segments_meet(a, b, square[k], square[(k + 1) % 4]) for a, b in edges for k in range(4))


def texels(snapped: list[int], width: int, height: int) -> set[tuple[int, int]]:
    """Return the texels (i, j) of the grid that the triangle x0 y0 x1 y1 x2 y2 touches."""
    t = [(int(snapped[2 * c]), int(snapped[2 * c + 1])) for c in range(3)]
    xs, ys = [p[0] for p in t], [p[1] for p in t]
    return {
        (i, j)
        for i in range(max(min(xs) // 256 - 1, 0), min(max(xs) // 256 + 1, width))
        for j in range(max(min(ys) // 256 - 1, 0), min(max(ys) // 256 + 1, height))
        if touches(t, i, j)
    }
