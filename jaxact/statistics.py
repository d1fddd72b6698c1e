"""Confidence intervals for what an evaluation measured, and what a random search can expect."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from jaxact.errors import JaxactError


def confidence_interval(successes: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Returns Wilson's score interval for a proportion.

    Unlike the textbook's normal interval it stays within [0, 1] and keeps its coverage near 0 and
    1 and for few trials. Source: E. B. Wilson, "Probable inference, the law of succession, and
    statistical inference", JASA 22 (1927), recommended by Brown, Cai and DasGupta, "Interval
    estimation for a binomial proportion", Statistical Science 16 (2001).

    Args:
      successes: how many trials succeeded.
      n: how many there were; with none the interval is (0, 1).
      level: the coverage, between 0 and 1.

    Returns:
      Lower and upper end.

    Raises:
      JaxactError: the counts or the level are out of range.

    >>> low, high = confidence_interval(8, 10)
    >>> f"{low:.4f} {high:.4f}"
    '0.4902 0.9433'
    """
    _check_level(level)
    if not 0 <= successes <= n:
        raise JaxactError(f"expected 0 <= successes <= n, but got {successes} of {n}")
    if n == 0:
        return 0.0, 1.0
    z = float(special.ndtri((1 + level) / 2))
    p = successes / n
    center = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    # At the borders the ends are exact; rounding must not push them off.
    low = 0.0 if successes == 0 else center - half
    high = 1.0 if successes == n else center + half
    return low, high


def mean_interval(values: Sequence[float] | np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Returns Student's t interval for the mean.

    Exact for normal values and close for means of many, such as returns over seeds. Source:
    "Student", "The probable error of a mean", Biometrika 6 (1908).

    Args:
      values: [n] numbers, n >= 1; of one value nothing is known and the interval is infinite.
      level: the coverage, between 0 and 1.

    Returns:
      Lower and upper end.

    Raises:
      JaxactError: there are no values, or the level is out of range.

    >>> low, high = mean_interval([1.0, 2.0, 3.0])
    >>> f"{low:.4f} {high:.4f}"
    '-0.4841 4.4841'
    """
    _check_level(level)
    array = np.asarray(values, np.float64).ravel()
    if array.size == 0:
        raise JaxactError("expected at least one value to take the mean of, but got none")
    if array.size == 1:
        return -math.inf, math.inf
    error = array.std(ddof=1) / math.sqrt(array.size)
    half = float(special.stdtrit(array.size - 1, (1 + level) / 2) * error)
    mean = float(array.mean())
    return mean - half, mean + half


def expected_best(values: Sequence[float] | np.ndarray, k: int, *, smallest: bool = False) -> float:
    """Returns the mean of the best of `k` of the values, over all ways of choosing k of them.

    It is what a random search with k draws can expect, estimated from n ≥ k draws without bias;
    k = 1 gives the mean and k = n the best. Source: the expected validation performance of J. Dodge
    et al., "Show your work: improved reporting of experimental results", EMNLP 2019, but without
    replacement, as L. Weihs et al., "Bridging the imitation gap by adaptive insubordination",
    NeurIPS 2021, report it.

    Args:
      values: [n] finite numbers, one for each draw.
      k: how many draws the search has, 1 to n.
      smallest: the best is the smallest value instead of the largest.

    Raises:
      JaxactError: k is out of range, or a value is not finite.

    >>> f"{expected_best([0.0, 1.0, 2.0], 2):.4f}"  # of (0, 1), (0, 2) and (1, 2)
    '1.6667'
    """
    array = _checked_draws(values, k)
    return float(_sorted_by_rank(array, smallest) @ _rank_weights(array.size, k))


def expected_best_interval(
    values: Sequence[float] | np.ndarray,
    k: int,
    level: float = 0.95,
    *,
    smallest: bool = False,
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """Returns a percentile bootstrap interval for `expected_best`.

    The draws are drawn anew, with replacement. For k near n the interval is too narrow above, since
    no resample has a better draw than the best there is. Source: B. Efron and R. J. Tibshirani, "An
    introduction to the bootstrap" (1993), chapter 13.

    Args:
      values: [n] finite numbers, one for each draw.
      k: how many draws the search has, 1 to n.
      level: the coverage, between 0 and 1.
      smallest: the best is the smallest value instead of the largest.
      resamples: how many times the draws are drawn anew.
      seed: of the resampling.

    Returns:
      Lower and upper end.

    Raises:
      JaxactError: k or the level is out of range, or a value is not finite.
    """
    _check_level(level)
    array = _checked_draws(values, k)
    chosen = np.random.default_rng(seed).integers(array.size, size=(resamples, array.size))
    bests = _sorted_by_rank(array[chosen], smallest) @ _rank_weights(array.size, k)
    low, high = np.quantile(bests, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _checked_draws(values: Sequence[float] | np.ndarray, k: int) -> np.ndarray:
    array = np.asarray(values, np.float64).ravel()
    if not 1 <= k <= array.size:
        raise JaxactError(f"expected 1 <= k <= {array.size} draws, but got k = {k}")
    if not np.isfinite(array).all():
        raise JaxactError("expected finite values; give draws that have none the worst there is")
    return array


def _sorted_by_rank(values: np.ndarray, smallest: bool) -> np.ndarray:
    """Sorts along the last axis, the best at the end."""
    ascending = np.sort(values, axis=-1)
    return ascending[..., ::-1] if smallest else ascending


def _rank_weights(n: int, k: int) -> np.ndarray:
    """Returns the probabilities [n] that the i-th worst of n values is the best of k of them."""
    return np.array([math.comb(i, k - 1) / math.comb(n, k) for i in range(n)])


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise JaxactError(f"expected a level between 0 and 1, but got {level}")
