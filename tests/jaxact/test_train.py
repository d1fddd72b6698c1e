"""Training from Python: what a run computes, logs, keeps and refuses."""

import dataclasses
import json
from importlib import import_module

import jax
import numpy as np
import pytest

from jaxact import JaxactError, override, train
from jaxact.checkpoints import Checkpoints
from jaxact.logs import read_metrics
from jaxact.program import Program, choose_devices
from jaxact.runs import create_run
from jaxact.train_state import make_key
from tests.tiny import OPTIONS, UPDATE, assert_same, experiment


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return train(experiment(), seed=1, output=tmp_path_factory.mktemp("runs"), **OPTIONS)


def test_the_same_seed_gives_the_same_run_bit_for_bit(trained, tmp_path, monkeypatch):
    """Also from a program of its own, traced anew."""
    monkeypatch.setattr(import_module("jaxact.train"), "Program", Program)
    again = train(experiment(), seed=1, output=tmp_path, **OPTIONS)
    assert_same(again.state, trained.state)
    assert_same(again.metrics, trained.metrics)
    assert_same(dataclasses.asdict(again.evaluation), dataclasses.asdict(trained.evaluation))
    for name in ("metrics.jsonl", "config.json", f"evaluation/{8 * UPDATE:012d}.json"):
        assert (again.run / name).read_bytes() == (trained.run / name).read_bytes()


def test_how_a_run_is_watched_changes_nothing_it_learns(trained):
    unwatched = train(experiment(), seed=1, evaluation_episodes=0, log_every=2 * UPDATE,
                      progress=False)  # fmt: skip
    assert_same(unwatched.state, trained.state)
    assert unwatched.evaluation is None
    assert unwatched.run is None


def test_another_seed_gives_another_run(trained):
    other = train(experiment(), seed=2, **OPTIONS)
    pairs = zip(jax.tree.leaves(other.state.params), jax.tree.leaves(trained.state.params),
                strict=True)  # fmt: skip
    assert any(not np.array_equal(a, b) for a, b in pairs)


def test_metrics_have_one_entry_for_each_update(trained):
    metrics = trained.metrics
    assert {len(x) for x in metrics.values()} == {8}
    assert metrics["step"].tolist() == [UPDATE * n for n in range(1, 9)]
    assert metrics["stage"].tolist() == [0] * 4 + [1] * 4
    shared = {"success", "return", "length", "forced", "gradient_norm", "learning_rate"}
    assert {f"train/{name}" for name in shared} <= metrics.keys()
    assert {"train/reward/success", "train/reward/step", "train/task/distance"} <= metrics.keys()
    assert np.isfinite(metrics["losses/imitation/cross_entropy"][:4]).all()
    assert np.isnan(metrics["losses/imitation/cross_entropy"][4:]).all()
    assert np.isnan(metrics["losses/ppo/policy"][:4]).all()
    assert np.isfinite(metrics["losses/ppo/policy"][4:]).all()


def test_schedules_run_on_their_own_clock(trained):
    """A stage's on the steps of the stage, the pipeline's learning rate on those of all stages."""
    metrics = trained.metrics
    np.testing.assert_allclose(metrics["train/teacher_forcing"], [1, 0.75, 0.5, 0.25, 0, 0, 0, 0])
    own = [2e-2, 1.75e-2, 1.5e-2, 1.25e-2]
    common = [1e-2 * (1 - n / 8) for n in range(4, 8)]
    np.testing.assert_allclose(metrics["train/learning_rate"], own + common, rtol=1e-6)


def test_full_teacher_forcing_takes_all_advice(trained):
    metrics = trained.metrics
    assert metrics["train/forced"][0] == metrics["losses/imitation/advised"][0] > 0
    assert metrics["train/forced"][0] > metrics["train/forced"][3] > 0
    assert np.all(metrics["train/forced"][4:] == 0)


def test_a_run_keeps_everything_to_look_at_it_later(trained):
    names = {path.name for path in trained.run.iterdir()}
    assert {"config.json", "versions.json", "metrics.jsonl", "evaluation", "checkpoints"} <= names
    assert any(name.startswith("events.out.tfevents") for name in names)
    config = json.loads((trained.run / "config.json").read_text())
    assert config["seed"] == 1
    assert config["experiment"]["pipeline"]["lanes"] == 8
    evaluations = sorted(path.name for path in (trained.run / "evaluation").iterdir())
    assert evaluations == [f"{n * UPDATE:012d}.json" for n in (4, 8)]
    saved = Checkpoints(trained.run / "checkpoints")
    assert saved.steps() == [n * UPDATE for n in (2, 4, 6, 8)]
    program = Program(experiment(), choose_devices(None))
    assert_same(saved.restore(None, program.like()).state, trained.state)


def test_logged_lines_sum_up_the_updates_between_them(trained):
    lines = [x for x in read_metrics(trained.run) if "train/success" in x]
    assert [x["step"] for x in lines] == [2 * UPDATE * n for n in range(1, 5)]
    metrics, count = trained.metrics, trained.metrics["episodes/count"]
    for i, line in enumerate(lines):
        rows = slice(2 * i, 2 * i + 2)
        assert line["train/episodes"] == count[rows].sum()
        successes = (metrics["train/success"][rows] * count[rows])[count[rows] > 0].sum()
        assert line["train/success"] == pytest.approx(successes / count[rows].sum(), abs=1e-6)
        norm = metrics["train/gradient_norm"][rows].mean()
        assert line["train/gradient_norm"] == pytest.approx(norm, rel=1e-6)


def test_evaluations_are_written_as_they_were_measured(trained):
    record = json.loads((trained.run / "evaluation" / f"{8 * UPDATE:012d}.json").read_text())
    assert record["success"]["mean"] == float(trained.evaluation.success.mean())
    assert record["episodes"] == 40
    assert record["step"] == 8 * UPDATE
    logged = [x for x in read_metrics(trained.run) if "evaluation/success" in x]
    assert [x["step"] for x in logged] == [4 * UPDATE, 8 * UPDATE]
    assert logged[-1]["evaluation/success"] == pytest.approx(record["success"]["mean"])


def test_only_evaluated_checkpoints_have_a_score(trained):
    """A score is that of the very parameters saved, never of those evaluated some time before."""
    for path in sorted((trained.run / "checkpoints").iterdir()):
        manifest = json.loads((path / "checkpoint.json").read_text())
        assert (manifest["score"] is not None) == (manifest["step"] % (4 * UPDATE) == 0)


def test_a_run_can_be_cut_short(trained):
    short = train(experiment(), seed=1, **OPTIONS | {"total_steps": 3 * UPDATE})
    assert short.metrics["step"].tolist() == [UPDATE, 2 * UPDATE, 3 * UPDATE]
    for name in ("train/learning_rate", "losses/total", "train/teacher_forcing"):
        np.testing.assert_array_equal(short.metrics[name], trained.metrics[name][:3])


def test_initial_weights_are_taken_from_any_run_with_such_a_model(tmp_path):
    """With learning rates of zero they are still there at the end; nothing else is taken over."""
    other = experiment(name="other", lanes=4, minibatches=1)
    state = Program(other, choose_devices(1)).start(make_key(5))
    source = create_run(tmp_path, "other", {})
    Checkpoints(source / "checkpoints").save(7, state, metadata={})
    still = override(
        experiment(),
        {
            "pipeline.learning_rate.start": 0.0,
            "pipeline.stages.0.overrides.learning_rate.start": 0.0,
            "pipeline.stages.0.overrides.learning_rate.end": 0.0,
        },
    )
    options = OPTIONS | {"evaluation_episodes": 0}
    result = train(still, seed=1, initial_weights=source, **options)
    assert_same(result.state.params, state.params)
    assert result.metrics["step"][0] == UPDATE


def test_a_loss_that_is_not_finite_ends_the_run_and_leaves_its_checkpoints(tmp_path):
    hot = override(experiment(), {"pipeline.learning_rate.start": 1e38})
    with pytest.raises(JaxactError, match=r"^losses/.* became .* in stage 1 after 256 steps"):
        train(hot, output=tmp_path, **OPTIONS)
    (run,) = (tmp_path / "corridor").iterdir()
    saved = Checkpoints(run / "checkpoints")
    assert saved.steps() == [2 * UPDATE, 4 * UPDATE]
    program = Program(hot, choose_devices(None))
    state = saved.restore(None, program.like()).state
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(state.params))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"outputs": "x"}, "unknown training option 'outputs'; the nearest is 'output'"),
        ({"initial_weights": "nowhere/run"}, "does not exist"),
        ({"resume": "nowhere/run"}, "does not exist"),
        ({"devices": 99}, "99 devices were asked for, but jax sees"),
        ({"total_steps": 0}, "total_steps must be at least 1"),
        ({"log_every": 0}, "log_every must be at least 1"),
        ({"checkpoint_every": -1}, "checkpoint_every must be at least 0"),
        ({"evaluation_episodes": -5}, "evaluation_episodes must be at least 0"),
    ],
)
def test_bad_options_are_told_before_anything_compiles(option, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def compiled(*_):
        raise AssertionError("a stage was compiled")

    monkeypatch.setattr(import_module("jaxact.train"), "Program", Program)
    monkeypatch.setattr(Program, "stage", compiled)
    with pytest.raises(JaxactError, match=message):
        train(experiment(), **option)
    assert not list(tmp_path.iterdir())
