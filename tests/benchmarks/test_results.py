"""Results of finished runs: seeds of an experiment together, what was first at which step."""

import json

import pytest

from benchmarks.results import results_of
from jaxact.errors import JaxactError
from jaxact.runs import write_json
from jaxact.statistics import mean_interval


def make_run(directory, seed, successes, *, name="walk", fingerprint="f", steps=300):
    """A run evaluated every 100 steps; without episodes of its own if its name says so."""
    run = directory / f"{name}-{fingerprint}-{seed}"
    (run / "evaluation").mkdir(parents=True)
    stages = [{"steps": steps}]
    experiment = {"name": name, "pipeline": {"stages": stages}}
    config = {"experiment": experiment, "fingerprint": fingerprint, "seed": seed}
    write_json(run / "config.json", config | {"overrides": ["a.b=1"], "source": "walk.py"})
    write_json(run / "versions.json", {"jax": "1"})
    own = {} if name == "offline" else {f"train/{n}": 0.5 for n in ("success", "return", "length")}
    lines = []
    for i, success in enumerate(successes, start=1):
        one = {"mean": success, "interval": [success - 0.01, success + 0.01]}
        summary = {"step": 100 * i, "success": one, "return": one, "length": one}
        write_json(run / "evaluation" / f"{100 * i:04d}.json", summary)
        lines += [{"step": 100 * i, "stage": 0.0} | own, {"step": 100 * i, "evaluation/success": 0}]
    (run / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return run


def test_seeds_of_an_experiment_are_one_result(tmp_path):
    runs = [
        make_run(tmp_path, 1, [0.5, 0.98, 0.99]),
        make_run(tmp_path, 0, [0.97, 0.9, 0.95]),
        make_run(tmp_path, 7, [0.2], name="offline", steps=100),
    ]
    walk, offline = results_of(runs, "abc")
    assert (walk["name"], walk["commit"], walk["seeds"]) == ("walk", "abc", [0, 1])
    success = walk["final"]["success"]
    assert success["each"] == [0.95, 0.99]
    assert success["mean"] == pytest.approx(0.97)
    assert success["interval"] == mean_interval([0.95, 0.99])
    assert walk["first_at"] == {"0.97": [100, 200], "0.99": [None, 300]}
    first = walk["runs"][0]
    assert first["command"] == "python -m jaxact.train walk --seed 0 --set a.b=1"
    assert first["curve"]["step"] == [100, 200, 300]
    assert first["curve"]["train/success"] == [0.5] * 3
    # A single seed has its evaluation's interval, and demonstrations alone no episodes.
    assert offline["final"]["success"]["interval"] == [0.19, 0.21000000000000002]
    assert set(offline["runs"][0]["curve"]) == {"step"}


def test_one_of_a_files_experiments_is_told_by_its_name_and_may_have_a_metric_of_its_own(tmp_path):
    run = make_run(tmp_path, 0, [0.5])
    config = json.loads((run / "config.json").read_text())
    write_json(run / "config.json", config | {"source": "walks.py:blind"})
    file = run / "evaluation" / "0100.json"
    spl = {"mean": 0.25, "interval": [0.2, 0.3]}
    write_json(file, json.loads(file.read_text()) | {"task/spl": spl})
    (result,) = results_of([run], "abc")
    command = "python -m jaxact.train examples/walks.py:blind --seed 0 "
    assert result["runs"][0]["command"].startswith(command)
    assert result["final"]["task/spl"] == {"mean": 0.25, "each": [0.25], "interval": [0.2, 0.3]}


def test_a_run_that_stopped_early_says_so(tmp_path):
    (result,) = results_of([make_run(tmp_path, 0, [0.5], steps=300)], "abc")
    assert result["runs"][0]["command"].endswith("--total-steps 100")


def test_runs_that_differ_in_more_than_the_seed_are_refused(tmp_path):
    run = make_run(tmp_path, 0, [0.5])
    for other in (make_run(tmp_path, 1, [0.5], fingerprint="g"), run):
        with pytest.raises(JaxactError, match="should differ in the seed and in nothing else"):
            results_of([run, other], "abc")
