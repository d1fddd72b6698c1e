"""The study of ADVISOR's methods: what it writes, and what it refuses."""

import csv
import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest

import jaxact
from benchmarks.advisor_study import PUBLISHED, Arguments, study
from jaxact.errors import JaxactError
from jaxact.statistics import expected_best
from jaxact.sweep import SweepResult


def draws(best):
    """Ten draws, one of which had no finite return."""
    return [
        {"draw": k, "seed": 0, "numbers": {"x": k}, "diverged": None,
         "evaluations": [{"step": 1, "return": None if k == 5 else best - k / 10}]}
        for k in range(10)
    ]  # fmt: skip


def test_methods_are_added_to_those_there_are(tmp_path, monkeypatch):
    searched = []

    def sweep(experiment, space, draws_of=draws, **options):
        searched.append((experiment.name, options["draws"]))
        return SweepResult(draws_of(0.9 if "ppo" in experiment.name else 0.4), None)

    monkeypatch.setattr(jaxact, "sweep", sweep, raising=False)
    arguments = Arguments("poisoned_doors", ("bc", "ppo"), output=tmp_path)
    study(arguments)
    study(Arguments("poisoned_doors", (), draws=11, output=tmp_path))
    assert searched[:2] == [("advisor_poisoned_doors_bc", 10), ("advisor_poisoned_doors_ppo", 10)]
    assert len(searched) == len({name for name, _ in searched}) == len(PUBLISHED["poisoned_doors"])
    result = json.loads((tmp_path / "advisor_poisoned_doors.json").read_text())
    assert list(result["methods"]) == list(PUBLISHED["poisoned_doors"])
    found = result["methods"]["ppo"]
    assert found["best_of_10"]["mean"] == pytest.approx(0.9)
    there = PUBLISHED["poisoned_doors"]["ppo"]
    assert found["published_best_of_10"] == {"mean": there.mean, "range": [there.low, there.high]}
    low, high = found["best_of_10"]["interval"]
    assert low < 0.9
    assert math.isclose(high, 0.9)
    assert found["records"] == draws(0.9)
    assert (tmp_path / "advisor_poisoned_doors.png").stat().st_size > 0


def test_the_newest_sweep_of_a_method_is_gone_on_with(tmp_path, monkeypatch):
    resumed = []

    def sweep(experiment, space, **options):
        resumed.append(options["resume"])
        return SweepResult(draws(0.5), None)

    monkeypatch.setattr(jaxact, "sweep", sweep, raising=False)
    newest = tmp_path / "advisor_poisoned_doors_bc" / "2026-02-01_00-00-00"
    for directory in (newest, newest.with_name("2026-01-31_00-00-00")):
        directory.mkdir(parents=True)
    study(Arguments("poisoned_doors", ("bc", "ppo"), sweeps=tmp_path, output=tmp_path))
    assert resumed == [newest, None]


def test_what_cannot_be_searched():
    with pytest.raises(JaxactError, match="unknown method 'ppoo'; the nearest is 'ppo'"):
        study(Arguments("lava_crossing", ("ppoo",)))
    with pytest.raises(JaxactError, match="the best of 10 needs as many draws; got 9"):
        study(Arguments("lava_crossing", ("ppo",), draws=9))


# AllenAct's published random searches of ADVISOR, kept beside the repository if at all.
RUNS = Path(__file__).parents[3] / "shared" / "data" / "advisor"
TASKS = {"lava_crossing": "LavaCrossingCorruptExpertS15N7", "poisoned_doors": "PoisonedDoors"}
NAMES = {
    "bc_forced": "bc_teacher_forcing",
    "bc_to_ppo": "bc_then_ppo",
    "dagger_to_ppo": "dagger_then_ppo",
    "bc_forced_to_ppo": "bc_teacher_forcing_then_ppo",
    "advisor_demonstrations": "ppo_with_offpolicy_advisor",
}


@pytest.mark.skipif(not RUNS.is_dir(), reason="the published random searches are not here")
@pytest.mark.parametrize("world", TASKS)
def test_what_was_published_is_in_the_published_draws(world):
    rewards = {}
    with gzip.open(RUNS / f"random_hp_search_runs_{TASKS[world]}.tsv.gz", "rt") as file:
        for row in csv.DictReader(file, delimiter="\t"):
            rewards.setdefault(row["exp_type"], []).append(json.loads(row["reward"])[-1])
    generator = np.random.default_rng(0)
    for method, published in PUBLISHED[world].items():
        draws = np.array(rewards[NAMES.get(method, method)])
        assert expected_best(draws, 10) == pytest.approx(published.mean, abs=0.0006)
        best = generator.permuted(np.tile(draws, (20_000, 1)), axis=1)[:, :10].max(1)
        # Draws are discrete, so a percentile by chance may be the draw next to it.
        low, high = np.quantile(best, [0.02, 0.03]), np.quantile(best, [0.97, 0.98])
        assert low[0] - 0.0006 <= published.low <= low[1] + 0.0006
        assert high[0] - 0.0006 <= published.high <= high[1] + 0.0006
