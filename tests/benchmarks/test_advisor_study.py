"""The study of ADVISOR's methods: what it writes, and what it refuses."""

import json
import math

import pytest

import jaxact
from benchmarks.advisor_study import PUBLISHED, Arguments, study
from jaxact.errors import JaxactError
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
    low, high = found["best_of_10"]["interval"]
    assert low < 0.9
    assert math.isclose(high, 0.9)
    assert found["records"] == draws(0.9)
    assert (tmp_path / "advisor_poisoned_doors.png").stat().st_size > 0


def test_what_cannot_be_searched():
    with pytest.raises(JaxactError, match="unknown method 'ppoo'; the nearest is 'ppo'"):
        study(Arguments("lava_crossing", ("ppoo",)))
    with pytest.raises(JaxactError, match="the best of 10 needs as many draws; got 9"):
        study(Arguments("lava_crossing", ("ppo",), draws=9))
