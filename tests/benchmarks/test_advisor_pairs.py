"""The published draws are the published ones, and pairs are compared as pairs."""

import csv
import gzip
import json

import numpy as np
import pytest
from scipy import stats

from benchmarks import advisor_pairs
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


@pytest.mark.skipif(not RUNS.is_dir(), reason="the published random searches are not here")
@pytest.mark.parametrize("method", advisor_pairs.PUBLISHED)
def test_the_draws_are_ten_of_the_published_ones(method):
    path = RUNS / f"random_hp_search_runs_{TASKS[advisor_pairs.WORLD]}.tsv.gz"
    with gzip.open(path, "rt") as file:
        rows = [
            row
            for row in csv.DictReader(file, delimiter="\t")
            if row["exp_type"] == NAMES.get(method, method)
        ]
    rows = sorted((row for row in rows if 2e-4 <= float(row["lr"]) <= 1e-2), key=rate)
    rows = [rows[i] for i in np.linspace(0, len(rows) - 1, 10).round().astype(int)]
    assert pytest.approx([rate(row) for row in rows]) == advisor_pairs.LEARNING_RATES
    others = [json.loads(row["config_kwargs_str"]) for row in rows]
    if method == "advisor":
        assert list(advisor_pairs.ALPHAS) == [x["FIXED_ALPHA"] for x in others]
    else:
        assert pytest.approx([x["TF_RATIO"] for x in others]) == advisor_pairs.WARM_STARTS
    last = [json.loads(row["reward"])[-1] for row in rows]
    assert advisor_pairs.PUBLISHED[method] == pytest.approx(last, abs=6e-4)


def rate(row):
    return float(row["lr"])
