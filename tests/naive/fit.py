"""Made-up measured frames, and the loss that a quantile fit is to make least, written down."""

import numpy as np

TRUE = np.array([1.2e6, 9_000.0, 4.0, 0.06, 900.0, 6.0, 0.05])  # ns: a frame, then a unit of each column


def frames(n: int, *, seed: int = 0, noise=lambda rng, ns: 0.0 * ns) -> np.ndarray:
    """Return (n,7) samples whose times are those of TRUE plus `noise(rng, ns)`, which sees the true nanoseconds."""
    rng = np.random.default_rng(seed)
    most = np.array([2_000, 500_000, 4e6, 300, 4_000, 2e6])
    drawn = np.floor(rng.random((n, 6)) ** 1.5 * most)
    ns = TRUE[0] + (drawn * TRUE[1:]).sum(1)
    return np.concatenate([drawn, ((ns + noise(rng, ns)) / 1e6)[:, None]], axis=1)


def loss(samples: np.ndarray, coefficient: np.ndarray, quantile: float) -> float:
    """Sum of quantile * what is missing + (1 - quantile) * what is too much, nanoseconds."""
    total = 0.0
    for row in samples:
        short = row[-1] * 1e6 - coefficient[0] - sum(c * x for c, x in zip(coefficient[1:], row[:-1]))
        total += quantile * short if short > 0 else (quantile - 1) * short
    return total
