"""Confidence intervals for what an evaluation measured."""

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


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise JaxactError(f"expected a level between 0 and 1, but got {level}")
