"""Reports of sweeps: scores, the table and the figure."""

import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.runs import create_run
from jaxact.statistics import expected_best
from jaxact.sweep_records import append_records
from jaxact.sweep_report import draw_scores, expected_best_curve, report


def record(draw, success, seed=0, length=5.0, diverged=None):
    evaluations = [
        {"step": 10, "success": 1.0, "length": 9.0},
        {"step": 20, "success": success, "length": length},
    ]
    numbers = {"pipeline.learning_rate": 0.25 * draw}
    return {
        "draw": draw,
        "seed": seed,
        "numbers": numbers,
        "diverged": diverged,
        "evaluations": evaluations,
    }


def make_sweep(output, name, records):
    config = {
        "space": {"pipeline.learning_rate": "uniform(0.0, 1.0)"},
        "experiment": {"name": name},
    }
    directory = create_run(output, name, config)
    append_records(directory, records)
    return directory


def test_a_draw_scores_the_mean_over_its_seeds_at_the_last_evaluation():
    records = [record(0, 0.5), record(0, 0.7, seed=1), record(1, 0.2), record(1, 0.2, seed=1)]
    np.testing.assert_allclose(draw_scores(records), [0.6, 0.2])


def test_what_was_not_finite_is_the_worst():
    records = [record(0, 0.5), record(1, None, length=None), record(2, 0.1, length=7.0)]
    np.testing.assert_allclose(draw_scores(records), [0.5, 0.1, 0.1])
    np.testing.assert_allclose(draw_scores(records, "length", smallest=True), [5.0, 7.0, 7.0])
    with pytest.raises(JaxactError, match="success was finite in none of the 1 runs"):
        draw_scores([record(0, None)])
    with pytest.raises(JaxactError, match="unknown metric 'succes'; the nearest is 'success'"):
        draw_scores(records, "succes")


def test_a_curve_rises_from_the_mean_to_the_best():
    scores = np.random.default_rng(0).uniform(size=70)
    points = expected_best_curve("x", scores).points
    assert list(points) == [*range(1, 51), 70]
    assert points[1][0] == pytest.approx(scores.mean())
    assert points[10][0] == expected_best(scores, 10)
    assert points[70][0] == pytest.approx(scores.max())
    assert all(low <= expected <= high for expected, low, high in points.values())


def test_a_report_compares_sweeps(tmp_path):
    many = make_sweep(tmp_path, "many", [record(i, i / 20) for i in range(20)])
    few = make_sweep(tmp_path, "few", [record(0, 0.5), record(1, 0.25, diverged=10)])
    lines = report([many, few], figure=tmp_path / "figures" / "best.png").splitlines()
    assert lines[0] == "expected largest success of k draws [95 % bootstrap interval]"
    assert lines[1].split() == ["k", "1", "2", "5", "10", "20"]
    assert lines[2].split()[:2] == ["many", "0.475"]
    assert lines[3].split()[0] == "few"
    assert lines[3].split()[-3:] == ["-", "-", "-"]
    assert lines[5].endswith(
        "20 draws, 0 diverged; the best is draw 19 with 0.950: --set pipeline.learning_rate=4.75"
    )
    assert "2 draws, 1 diverged; the best is draw 0 with 0.500" in lines[6]
    for suffix in (".png", ".svg"):
        drawn = tmp_path / "figures" / f"best{suffix}"
        assert drawn.stat().st_size > 1000
        assert str(drawn) in lines[7]


def test_sweeps_of_one_experiment_are_told_apart(tmp_path):
    sweeps = [make_sweep(tmp_path, "same", [record(0, 0.5)]) for _ in range(2)]
    lines = report(sweeps).splitlines()
    assert [line.split()[:2] for line in lines[2:4]] == [["same", x.name] for x in sweeps]
    assert (sweeps[0] / "expected_best.svg").is_file()


def test_a_sweep_without_a_finished_run_has_no_report(tmp_path):
    with pytest.raises(JaxactError, match="has no finished run yet"):
        report([make_sweep(tmp_path, "empty", [])])
