"""A resumed run is the run that was never stopped, bit for bit."""

import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap

import pytest

from jaxact import JaxactError, override, train
from jaxact.checkpoints import Checkpoints
from jaxact.program import Program, choose_devices
from jaxact.train import Run
from tests.tiny import OPTIONS, UPDATE, assert_same, curriculum, experiment


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    return train(experiment(), seed=1, output=tmp_path_factory.mktemp("runs"), **OPTIONS)


def assert_same_run(run, other):
    files = ("metrics.jsonl", "config.json", f"evaluation/{8 * UPDATE:012d}.json")
    for name in files:
        assert (run / name).read_bytes() == (other / name).read_bytes(), name
    like = Program(experiment(), choose_devices(1)).like()
    one, another = (Checkpoints(path / "checkpoints").restore(None, like) for path in (run, other))
    assert one.step == another.step
    assert_same(one.state, another.state)


@pytest.mark.parametrize("updates", [2, 4, 6])
def test_resuming_anywhere_ends_at_the_same_place(unbroken, updates, tmp_path):
    """In the first stage, between the two, and in the second; what was logged beyond is redone."""
    run = tmp_path / "copy"
    shutil.copytree(unbroken.run, run)
    for path in (run / "checkpoints").iterdir():
        if int(path.name) > updates * UPDATE:
            shutil.rmtree(path)
    resumed = train(experiment(), seed=1, resume=run, **OPTIONS)
    assert_same(resumed.state, unbroken.state)
    assert resumed.metrics["step"].tolist() == [UPDATE * n for n in range(updates + 1, 9)]
    assert_same_run(run, unbroken.run)


@pytest.mark.slow
def test_what_a_curriculum_has_learnt_is_resumed(tmp_path):
    """A ladder of levels that are played again, stopped on its upper rung in the first stage."""
    small = experiment(curriculum())
    whole = train(small, seed=1, output=tmp_path / "whole", **OPTIONS)
    assert int(whole.state.sampler.rung) == 1
    replayed, repeated = whole.state.sampler.rungs
    assert int(replayed.episodes) > 0
    assert int(repeated.ended) > 0
    for path in (whole.run / "checkpoints").iterdir():
        if int(path.name) > 2 * UPDATE:
            shutil.rmtree(path)
    resumed = train(small, seed=1, resume=whole.run, **OPTIONS)
    assert resumed.metrics["step"].tolist() == [UPDATE * n for n in range(3, 9)]
    assert_same(resumed.state, whole.state)


def test_a_finished_run_resumed_is_only_evaluated_again(unbroken, tmp_path):
    shutil.copytree(unbroken.run, tmp_path / "copy")
    resumed = train(experiment(), seed=1, resume=tmp_path / "copy", **OPTIONS)
    assert_same(resumed.state, unbroken.state)
    lines, before = (
        (run / "metrics.jsonl").read_text().splitlines() for run in (resumed.run, unbroken.run)
    )
    assert lines[: len(before)] == before
    assert lines[len(before) :] == before[-1:]
    assert len(resumed.metrics) == 0


def test_another_experiment_is_refused_before_anything_compiles(unbroken, tmp_path, monkeypatch):
    shutil.copytree(unbroken.run, tmp_path / "copy")
    before = sorted(path.name for path in (tmp_path / "copy").rglob("*"))
    monkeypatch.setattr(Program, "stage", None)
    other = override(experiment(), {"pipeline.discount": 0.5})
    with pytest.raises(JaxactError, match="belongs to another experiment: it was saved by"):
        train(other, resume=tmp_path / "copy", **OPTIONS)
    assert sorted(path.name for path in (tmp_path / "copy").rglob("*")) == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_with_a_checkpoint(unbroken, number, tmp_path, monkeypatch):
    def killed(self, state, before, rows):
        if self._steps(state) == 6 * UPDATE:
            os.kill(os.getpid(), number)
        after_chunk(self, state, before, rows)

    after_chunk = Run._after_chunk
    old = signal.getsignal(number)
    monkeypatch.setattr(Run, "_after_chunk", killed)
    options = OPTIONS | {"checkpoint_every": 0}
    result = train(experiment(), seed=1, output=tmp_path, **options)
    monkeypatch.undo()
    assert result.interrupted == number
    assert signal.getsignal(number) is old
    assert Checkpoints(result.run / "checkpoints").steps() == [6 * UPDATE]
    resumed = train(experiment(), seed=1, resume=result.run, **OPTIONS)
    assert_same(resumed.state, unbroken.state)
    assert_same_run(result.run, unbroken.run)


SCRIPT = """
    import os, sys, threading
    import jax
    from jaxact.train import Run
    from jaxact import command_line

    jax.config.update("jax_numpy_dtype_promotion", "strict")
    after_chunk = Run._after_chunk
    seconds, number = float(sys.argv.pop(1)), int(sys.argv.pop(1))

    def after(self, state, before, rows):
        if seconds == 0 and self._steps(state) == 384:
            os.kill(os.getpid(), number)
        if seconds > 0 and before == 128:
            threading.Timer(seconds, os.kill, (os.getpid(), number)).start()
        after_chunk(self, state, before, rows)

    Run._after_chunk = after
    command_line.run_train()
"""
FILE = """
    from tests.tiny import experiment as make

    experiment = make()
"""


@pytest.fixture
def start(tmp_path):
    """Starts `jaxact.train` in a process that sends itself a signal: at 384 steps, or later."""
    (tmp_path / "small.py").write_text(textwrap.dedent(FILE))

    def run(number, seconds, *arguments):
        options = ["--no-progress", "--log-every", "128", "--evaluate-every", "256"]
        options += ["--evaluation-episodes", "40", "--keep-last", "10", *arguments]
        script = [sys.executable, "-c", textwrap.dedent(SCRIPT), str(seconds), str(int(number))]
        return subprocess.run(
            [*script, *options],
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
)
def test_the_exit_code_names_the_signal(start, number, code, tmp_path):
    file, runs = str(tmp_path / "small.py"), str(tmp_path / "runs")
    ended = start(number, 0, file, "--output", runs, "--checkpoint-every", "0")
    assert ended.returncode == code, ended.stderr
    assert "Traceback" not in ended.stderr
    (run,) = (tmp_path / "runs" / "corridor").iterdir()
    assert Checkpoints(run / "checkpoints").steps() == [6 * UPDATE]


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(3))
def test_a_run_killed_at_any_moment_goes_on(start, attempt, tmp_path):
    """The kill comes after the first checkpoint, most often in the midst of another."""
    file, runs = str(tmp_path / "small.py"), tmp_path / "runs"
    seconds = random.Random(attempt).uniform(0.001, 0.5)
    options = ("--checkpoint-every", "64")
    killed = start(signal.SIGKILL, seconds, file, "--output", str(runs), *options)
    assert killed.returncode in (-signal.SIGKILL, 0), killed.stderr
    (run,) = (runs / "corridor").iterdir()
    for path in (run / "checkpoints").iterdir():
        if path.name.isdigit():
            assert (path / "checkpoint.json").is_file()
    resumed = train(experiment(), seed=0, resume=run, **OPTIONS)
    unbroken = train(experiment(), seed=0, **OPTIONS)
    assert_same(resumed.state, unbroken.state)
