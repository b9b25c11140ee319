"""How many misses of how many rays allow which claim: the upper bound of Clopper and Pearson, one-sided, 95 %.

After    Clopper, Pearson. The Use of Confidence or Fiducial Limits Illustrated in the Case of the Binomial.
         Biometrika 26, 1934. It also holds for rays spread over parts that differ (Hoeffding, On the Distribution of the
         Number of Successes in Independent Trials, 1956).
"""

from scipy.special import betaincinv

CONFIDENCE = 0.95


def upper_ppm(missed: int, n: int) -> float:
    """Return the largest share, in parts per million, with which `missed` or fewer of n happen in 5 % of all trials."""
    return 1e6 if missed >= n else float(betaincinv(missed + 1.0, float(n - missed), CONFIDENCE)) * 1e6


def most_missed(n: int, *, ppm: float) -> int:
    """Return the most misses of n rays that keep `upper_ppm` at or below ppm; -1 where n is too small for any claim."""
    low, high = -1, n  # upper_ppm(low) <= ppm < upper_ppm(high)
    if ppm >= 1e6:
        return n
    while high - low > 1:
        middle = (low + high) // 2
        if upper_ppm(middle, n) <= ppm:
            low = middle
        else:
            high = middle
    return low
