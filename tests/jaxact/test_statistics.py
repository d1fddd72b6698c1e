import csv
import gzip
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from jaxact.errors import JaxactError
from jaxact.statistics import (
    confidence_interval,
    expected_best,
    expected_best_interval,
    mean_interval,
)

# AllenAct's published random searches of ADVISOR, kept beside the repository if at all.
PUBLISHED = Path(__file__).parents[3] / "shared" / "data" / "advisor"


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


@pytest.mark.parametrize("n", [1, 2, 5, 7])
@pytest.mark.parametrize("smallest", [False, True])
def test_expected_best_is_the_mean_over_all_choices(n: int, smallest: bool) -> None:
    values = np.random.default_rng(n).normal(size=n).round(1)  # with ties
    best = min if smallest else max
    for k in range(1, n + 1):
        choices = [best(choice) for choice in itertools.combinations(values, k)]
        assert expected_best(values, k, smallest=smallest) == pytest.approx(np.mean(choices))


def test_expected_best_of_many_draws_neither_overflows_nor_loses_digits() -> None:
    values = np.arange(1, 3001)
    for k in (1, 10, 1500, 3000):
        # The German tank problem: the largest of k of 1 … n is k (n + 1) / (k + 1) on average.
        assert expected_best(values, k) == pytest.approx(k * 3001 / (k + 1))


def test_interval_of_the_expected_best_covers() -> None:
    """Of uniform draws the best of k is k / (k + 1) on average."""
    draws = np.random.default_rng(0).uniform(size=(300, 40))
    ends = np.array([expected_best_interval(row, 4, 0.9, resamples=200) for row in draws])
    coverage = np.mean((ends[:, 0] <= 0.8) & (ends[:, 1] >= 0.8))
    assert abs(coverage - 0.9) < 0.06
    low, high = expected_best_interval(draws[0], 4, smallest=True)
    assert low < expected_best(draws[0], 4, smallest=True) < high < 0.5


def test_expected_best_refusals() -> None:
    with pytest.raises(JaxactError, match=r"1 <= k <= 3 draws, but got k = 4"):
        expected_best([1.0, 2.0, 3.0], 4)
    with pytest.raises(JaxactError, match="finite values"):
        expected_best_interval([1.0, math.nan], 1)


# Methods in the order of the published table's rows; tasks in that of its columns.
METHODS = (
    *("ppo", "bc", "dagger", "bc_teacher_forcing", "bc_with_ppo", "bc_then_ppo"),
    *("dagger_then_ppo", "bc_teacher_forcing_then_ppo", "pure_offpolicy", "ppo_with_offpolicy"),
    *("gail", "advisor", "bc_teacher_forcing_then_advisor", "dagger_then_advisor"),
    "ppo_with_offpolicy_advisor",
)
TASKS = (
    *("LavaCrossingCorruptExpertS15N7", "AskForHelpLavaCrossingSmall"),
    *("AskForHelpLavaCrossingOnce", "CrossingS25N10", "PoisonedDoors"),
    *("WallCrossingCorruptExpertS25N10", "AskForHelpSimpleCrossing"),
    *("AskForHelpSimpleCrossingOnce", "WallCrossingS25N10"),
)


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published random searches are not here")
@pytest.mark.parametrize("task", TASKS)
def test_expected_best_reproduces_the_published_searches(task: str) -> None:
    """Best of 10 of 50 draws, by the reward at the last checkpoint, to the two decimals printed."""
    rewards: dict[str, list[float]] = {}
    with gzip.open(PUBLISHED / f"random_hp_search_runs_{task}.tsv.gz", "rt") as file:
        for row in csv.DictReader(file, delimiter="\t"):
            rewards.setdefault(row["exp_type"], []).append(json.loads(row["reward"])[-1])
    with (PUBLISHED / "reward__all_results.tsv").open() as file:
        rows = list(csv.reader(file, delimiter="\t"))[1:]
    column = 1 + TASKS.index(task)
    published = {method: float(row[column]) for method, row in zip(METHODS, rows, strict=True)}
    assert {len(draws) for draws in rewards.values()} == {50}
    computed = {method: expected_best(draws, 10) for method, draws in rewards.items()}
    assert computed == pytest.approx(published, abs=0.005 + 1e-9)
