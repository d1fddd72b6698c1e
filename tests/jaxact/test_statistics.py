import math

import numpy as np
import pytest
from scipy import stats

from jaxact.errors import JaxactError
from jaxact.statistics import confidence_interval, mean_interval


@pytest.mark.parametrize(("successes", "n"), [(0, 5), (5, 5), (3, 10), (487, 512), (1, 1)])
@pytest.mark.parametrize("level", [0.9, 0.95])
def test_wilson_agrees_with_scipy(successes: int, n: int, level: float) -> None:
    expected = stats.binomtest(successes, n).proportion_ci(level, method="wilson")
    assert np.allclose(confidence_interval(successes, n, level), expected, atol=1e-12)


def test_wilson_at_the_borders() -> None:
    assert confidence_interval(0, 0) == (0.0, 1.0)
    assert confidence_interval(0, 7)[0] == 0.0
    assert confidence_interval(7, 7)[1] == 1.0


def test_mean_interval_agrees_with_scipy_and_covers() -> None:
    values = np.random.default_rng(0).normal(2.0, 3.0, (2000, 5))
    expected = stats.ttest_1samp(values[0], 0).confidence_interval(0.95)
    assert np.allclose(mean_interval(values[0]), expected)
    ends = np.array([mean_interval(row) for row in values])
    coverage = np.mean((ends[:, 0] <= 2.0) & (ends[:, 1] >= 2.0))
    assert abs(coverage - 0.95) < 0.015


def test_mean_interval_of_few() -> None:
    assert mean_interval([4.0]) == (-math.inf, math.inf)
    assert mean_interval([4.0, 4.0]) == (4.0, 4.0)


def test_refusals() -> None:
    with pytest.raises(JaxactError, match="0 <= successes <= n"):
        confidence_interval(3, 2)
    with pytest.raises(JaxactError, match="level between 0 and 1"):
        confidence_interval(1, 2, 95)
    with pytest.raises(JaxactError, match="at least one value"):
        mean_interval([])
