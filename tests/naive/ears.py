"""Ear clipping as one reads it in a book."""


def clip_ears(flat):
    """[(x, y)] counter-clockwise -> [(a, b, c)]: cut the first ear off, again and again; fan what has none."""

    def turn(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    def is_ear(a, b, c):
        if turn(a, b, c) <= 0:
            return False
        others = (p for p in left if p not in (a, b, c) and flat[p] not in (flat[a], flat[b], flat[c]))
        return not any(turn(a, b, p) >= 0 and turn(b, c, p) >= 0 and turn(c, a, p) >= 0 for p in others)

    left, found = list(range(len(flat))), []
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            if is_ear(a, b, c):
                found.append((a, b, c))
                del left[k]
                break
        else:
            break
    return found + [(left[0], left[k], left[k + 1]) for k in range(1, len(left) - 1)]
