"""The published draws are the published ones, and pairs are compared as pairs."""

import csv
import gzip
import json

import numpy as np
import pytest
from scipy import stats

from benchmarks import advisor_pairs
from benchmarks.advisor_study import PUBLISHED
from tests.benchmarks.test_advisor_study import NAMES, RUNS, TASKS


def record(draw, value):
    return {"draw": draw, "seed": 0, "evaluations": [{"step": 1, "return": value}]}


def test_pairs_are_compared_as_pairs():
    ours, published = (0.2, 0.9, 0.4), (0.1, 0.7, 0.6)
    found = advisor_pairs.compare([record(*x) for x in enumerate(ours)], published)
    assert found["ours"] == list(ours)
    expected = stats.ttest_rel(ours, published)
    assert found["difference"]["mean"] == pytest.approx(np.mean(ours) - np.mean(published))
    assert found["difference"]["interval"] == pytest.approx(expected.confidence_interval(0.95))
    assert found["best_of_10"] == pytest.approx({"ours": 0.9, "published": 0.7})
    # Ten of 50 hold the best of three with a probability of 1/5, or only the next, or the last.
    first, second, third = 1 / 5, 4 / 5 * 10 / 49, 4 / 5 * 39 / 49 * 10 / 48
    expected = 0.9 * first + 0.4 * second + 0.2 * third
    assert found["best_of_10_of_50"]["ours"] == pytest.approx(expected)


def test_methods_are_compared_draw_by_draw():
    rng = np.random.default_rng(0)
    values = {m: {x: rng.random(5) for x in ("ours", "published")} for m in ("advisor", "other")}
    found = advisor_pairs.advisor_ahead(values)
    assert list(found) == ["other"]
    for side, ahead in found["other"].items():
        expected = stats.ttest_rel(values["advisor"][side], values["other"][side])
        assert ahead["interval"] == pytest.approx(expected.confidence_interval(0.95))
    assert found["other"]["ours"] != found["other"]["published"]
    assert advisor_pairs.advisor_ahead({"other": values["other"]}) == {}


def test_draws_that_are_recorded_are_not_trained_again(tmp_path, monkeypatch):
    trained = []

    def train(method, draws, arguments):
        trained.append([x.learning_rate for x in draws])
        return [
            record(i, x.advisor) | {"numbers": {advisor_pairs.RATE: x.learning_rate}}
            for i, x in enumerate(draws)
        ]

    draws = advisor_pairs.DRAWS
    monkeypatch.setattr(advisor_pairs, "_train", train)
    arguments = advisor_pairs.Arguments(("advisor",), output=tmp_path)
    for some in (draws[1:3], draws[:4], draws[:4]):
        monkeypatch.setattr(advisor_pairs, "DRAWS", some)
        advisor_pairs.pair(arguments)
    assert trained == [[x.learning_rate for x in y] for y in (draws[1:3], (draws[0], draws[3]))]
    found = json.loads((tmp_path / "advisor_pairs.json").read_text())["methods"]["advisor"]
    assert found["ours"] == found["published"] == pytest.approx([x.advisor for x in draws[:4]])
    assert [x["draw"] for x in found["records"]] == [0, 1, 2, 3]


@pytest.mark.skipif(not RUNS.is_dir(), reason="the published random searches are not here")
@pytest.mark.parametrize("method", advisor_pairs.METHODS)
def test_the_draws_are_the_published_ones(method):
    path = RUNS / f"random_hp_search_runs_{TASKS[advisor_pairs.WORLD]}.tsv.gz"
    with gzip.open(path, "rt") as file:
        rows = [
            row
            for row in csv.DictReader(file, delimiter="\t")
            if row["exp_type"] == NAMES.get(method, method)
        ]
    rows = sorted((row for row in rows if 2e-4 <= float(row["lr"]) <= 1e-2), key=rate)
    draws = advisor_pairs.DRAWS
    assert pytest.approx([rate(row) for row in rows]) == [x.learning_rate for x in draws]
    others = [json.loads(row["config_kwargs_str"]) for row in rows]
    if method == "advisor":
        assert [x.alpha for x in draws] == [x["FIXED_ALPHA"] for x in others]
    else:
        assert pytest.approx([x["TF_RATIO"] for x in others]) == [x.warm_start for x in draws]
    last = [json.loads(row["reward"])[-1] for row in rows]
    assert [getattr(x, method) for x in draws] == pytest.approx(last, abs=6e-4)
    # The draws that are left out hardly matter.
    records = [record(i, x) for i, x in enumerate(last)]
    best = advisor_pairs.compare(records, last)["best_of_10_of_50"]["published"]
    assert best == pytest.approx(PUBLISHED[advisor_pairs.WORLD][method].mean, abs=2e-3)


def rate(row):
    return float(row["lr"])
