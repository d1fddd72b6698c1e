"""Random search: draws side by side are draws alone, and a sweep that was stopped goes on."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxact
from jaxact import JaxactError, Stage, command_line, override, sweep
from jaxact.losses import Imitation
from jaxact.options import SweepOptions
from jaxact.progress import ProgressDisplay
from jaxact.runs import create_run
from jaxact.schedules import Linear
from jaxact.search_space import SearchSpace, choice, uniform
from jaxact.sweep import Sweep
from jaxact.sweep_program import Piece, SweepProgram, pieces
from jaxact.sweep_records import read_records
from tests.tiny import OPTIONS, UPDATE, experiment

RATE, FORCING = "pipeline.learning_rate.start", "pipeline.stages.0.teacher_forcing"
# So large a rate makes every loss NaN after its first update.
SPACE = {
    RATE: choice(1e-2, 3e38),
    (f"{FORCING}.steps", "pipeline.learning_rate.steps"): uniform(256.0, 512.0),
}
# Of the first three draws of this seed the second diverges.
SETTINGS = {"draws": 3, "draw_seed": 13, "evaluations": 2, "evaluation_episodes": 40}
SETTINGS |= {"progress": False}
FITTING = Sweep._fitting_program


def small(name="corridor"):
    """Eight updates of DAgger."""
    forcing = Linear(1.0, 0.0, 8.0 * UPDATE)
    stage = Stage({"imitation": Imitation()}, steps=8 * UPDATE, teacher_forcing=forcing)
    return experiment(name=name, stages=(stage,))


@pytest.fixture(scope="module", autouse=True)
def program():
    """All sweeps here share one program for chunks of two runs."""
    cut, paths = pieces(small().pipeline, 2), SearchSpace.of(SPACE).paths
    one = SweepProgram(small(), paths, 2, (jax.devices()[0],), cut, greedy=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sweep, "_fitting_program", lambda self, runs: one)
        yield one


@pytest.fixture(scope="module")
def searched(program, tmp_path_factory):
    """Three draws, the last beside nothing but padding."""
    return sweep(small(), SPACE, output=tmp_path_factory.mktemp("sweeps"), **SETTINGS)


@pytest.fixture
def copy(searched, tmp_path):
    """A copy of its directory."""
    return Path(shutil.copytree(searched.directory, tmp_path / "copy"))


def test_there_is_a_record_for_each_draw(searched):
    space = SearchSpace.of(SPACE)
    assert [(x["draw"], x["seed"]) for x in searched.records] == [(0, 0), (1, 0), (2, 0)]
    for record in searched.records:
        assert record["numbers"] == space.draw(13, record["draw"])
        assert [x["step"] for x in record["evaluations"]] == [4 * UPDATE, 8 * UPDATE]
        assert {"success", "return", "length", "task/distance"} <= record["evaluations"][0].keys()
    assert read_records(searched.directory) == searched.records
    config = json.loads((searched.directory / "config.json").read_text())
    assert (config["draws"], config["chunk"], config["seeds"]) == (3, 2, [0])
    assert config["space"][RATE] == "choice(0.01, 3e+38)"


def test_a_draw_that_diverges_is_recorded(searched):
    rates = [record["numbers"][RATE] for record in searched.records]
    assert rates == [1e-2, 3e38, 1e-2]
    for rate, record in zip(rates, searched.records, strict=True):
        assert (record["diverged"] is None) == (rate < 1)
        if rate > 1:
            # NaN logits choose action 0, left, where every other goal is.
            assert record["diverged"] == UPDATE
            first, last = record["evaluations"]
            assert first == last | {"step": 4 * UPDATE}
            assert 0.2 < last["success"] < 0.8


def test_a_draw_beside_one_that_diverges_is_the_draw_alone(searched):
    """Batched sums round differently, so that here and there an action is another one."""
    record = searched.records[0]
    alone = jaxact.train(override(small(), record["numbers"]), **OPTIONS | {"evaluate_every": 0})
    expected = alone.evaluation.summary()
    for name in ("success", "return", "length"):
        together = record["evaluations"][-1][name]
        assert together == pytest.approx(expected[name]["mean"], rel=0.02), name


def test_a_finished_sweep_has_nothing_to_do(searched, copy):
    again = sweep(small(), SPACE, resume=copy, progress=False)
    assert again.records == searched.records
    assert (copy / "draws.jsonl").read_bytes() == (searched.directory / "draws.jsonl").read_bytes()


def test_a_sweep_stopped_between_chunks_goes_on_to_the_same_file(searched, copy):
    path = copy / "draws.jsonl"
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2]) + lines[2][:50])
    assert sweep(small(), SPACE, resume=copy, progress=False).records == searched.records
    assert path.read_bytes() == whole


def test_a_sweep_stopped_within_a_chunk_goes_on_from_its_last_evaluation(
    searched, tmp_path, monkeypatch
):
    calls = []

    def count(self, *_):
        calls.append(_)
        if len(calls) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(ProgressDisplay, "update", count)
    with pytest.raises(KeyboardInterrupt):
        sweep(small(), SPACE, output=tmp_path, **SETTINGS)
    (stopped,) = (tmp_path / "corridor").iterdir()
    assert read_records(stopped) == []
    assert (stopped / "checkpoints").is_dir()
    assert sweep(small(), SPACE, resume=stopped, progress=False).records == searched.records
    assert not (stopped / "checkpoints").exists()
    # Eight pieces of one update: four were done, and four and the next chunk's eight were left.
    assert len(calls) == 6 + 4 + 8


def test_more_draws_extend_a_sweep(searched, copy):
    whole = (copy / "draws.jsonl").read_bytes()
    longer = sweep(small(), SPACE, resume=copy, draws=4, progress=False)
    assert longer.records[:3] == searched.records
    assert [x["draw"] for x in longer.records] == [0, 1, 2, 3]
    assert (copy / "draws.jsonl").read_bytes().startswith(whole)


def test_a_sweep_of_others_is_refused(searched, copy, tmp_path):
    other = small("another")
    with pytest.raises(JaxactError, match=r"is a sweep of another experiment: 'corridor' \(.* but"):
        sweep(other, SPACE, resume=copy)
    with pytest.raises(JaxactError, match=r"draws pipeline.*=choice\(0.01, 3e\+38\).* this sweep "):
        sweep(small(), {RATE: uniform(1e-3, 1.0)}, resume=copy)
    run = create_run(tmp_path, "corridor", {"seed": 0})
    with pytest.raises(JaxactError, match="is the run of a training, not a sweep"):
        sweep(small(), SPACE, resume=run)
    (copy / "draws.jsonl").write_text("{]\n")
    with pytest.raises(JaxactError, match="line 1 is not valid JSON"):
        sweep(small(), SPACE, resume=copy)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"draws": 0}, "draws must be at least 1, got 0"),
        ({"seeds": (1, 1)}, "different numbers"),
        ({"memory_gb": 0.0}, "memory_gb must be positive"),
        ({"draw_seed": -1}, "draw_seed must be at least 0"),
        ({"devices": 64}, "64 devices were asked for"),
        ({"drwas": 3}, "unknown sweep option 'drwas'; the nearest is 'draws'"),
    ],
)
def test_options_that_mean_nothing(options, message):
    with pytest.raises(JaxactError, match=message):
        sweep(small(), SPACE, **options)


def test_training_is_cut_where_policies_are_evaluated():
    """Four updates of 64 steps in each of two stages."""
    pipeline = experiment().pipeline
    one = [Piece(stage, 1, evaluate=False) for stage in (0, 1) for _ in range(4)]

    def evaluated(evaluations):
        cut = pieces(pipeline, evaluations)
        assert [dataclasses.replace(piece, evaluate=False) for piece in cut] == one
        return [i + 1 for i, piece in enumerate(cut) if piece.evaluate]

    assert evaluated(1) == [8]
    assert evaluated(2) == [4, 8]
    assert evaluated(3) == [3, 6, 8]
    assert evaluated(100) == [1, 2, 3, 4, 5, 6, 7, 8]
    long = dataclasses.replace(pipeline.stages[0], steps=1000 * UPDATE)
    cut = pieces(dataclasses.replace(pipeline, stages=(long,)), 3)
    assert sum(piece.updates for piece in cut) == 1000
    assert max(piece.updates for piece in cut) == 10
    ends = np.cumsum([piece.updates for piece in cut])[[piece.evaluate for piece in cut]]
    assert ends.tolist() == [334, 667, 1000]


def test_chunks_fit_into_memory(monkeypatch):
    """If each run took a gigabyte."""
    monkeypatch.setattr(SweepProgram, "bytes_needed", property(lambda self: self.chunk * 10**9))

    def chunk(runs, **options):
        search = Sweep(small(), SearchSpace.of(SPACE), SweepOptions(**options))
        return FITTING(search, runs).chunk

    assert chunk(50, memory_gb=1000.0) == 50
    assert chunk(50, memory_gb=20.5) == 17  # three chunks, filled as evenly as can be
    assert chunk(50, memory_gb=1.5) == 1
    assert chunk(50, chunk=40, memory_gb=20.0) == 40
    with pytest.raises(JaxactError, match=r"1 run\(s\) of corridor need 1.00 GB, and only 0.50 GB"):
        chunk(50, memory_gb=0.5)
    assert chunk(3) == 3


def test_matrices_are_factorized_one_at_a_time(program):
    # A batch of them waits for the threads that it runs on: on two cores, forever.
    lowered = program._traced_start.lower().as_text()
    factorized = re.findall(r"lapack_sgeqrf.*?: \(tensor<([^>]*)xf32>", lowered)
    assert factorized
    assert all(shape.count("x") == 1 for shape in factorized)


def test_memory_is_that_of_the_compiled_programs(program):
    state = sum(x.nbytes for x in jax.tree.leaves(program.like()) if hasattr(x, "nbytes"))
    assert state < program.bytes_needed < 2**30


@pytest.fixture
def call(monkeypatch, capsys):
    """(arguments) -> (exit code, what was printed, what went to stderr)."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["sweep", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command_line.run_sweep()
        printed = capsys.readouterr()
        return ended.value.code or 0, printed.out, printed.err

    return run


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.py"
    path.write_text("from tests.jaxact.test_sweep import small\n\nexperiment = small()\n")
    return path


TEXTS = SearchSpace.of(SPACE).to_texts()
DRAW = [x for paths, value in TEXTS.items() for x in ("--draw", f"{paths}={value}")]
FEW = [*DRAW, "--draws", "2", "--draw-seed", "13", "--evaluations", "2"]
FEW += ["--evaluation-episodes", "40"]


def test_the_command_line_searches_reports_and_resumes(call, searched, file, tmp_path):
    code, printed, errors = call(file, *FEW, "--output", tmp_path)
    assert (code, errors) == (0, "")
    (directory,) = (tmp_path / "corridor").iterdir()
    lines = printed.splitlines()
    assert lines[0] == "compiling"
    assert any(line.startswith("draws 0-1, 512 steps: success ") for line in lines)
    assert "expected largest success of k draws [95 % bootstrap interval]" in lines
    assert lines[-1] == f"sweep: {directory}"
    assert read_records(directory) == searched.records[:2]
    code, printed, errors = call("--resume", directory, "--draws", "3", "--no-progress")
    assert (code, errors) == (0, "")
    assert read_records(directory) == searched.records
    assert (directory / "expected_best.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name an experiment to search, or a sweep to --resume or to --report"),
        (("FILE",), "a search needs at least one number to draw"),
        (("FILE", "--draw", "pipeline.lanes=uniform(1,2)"), "pipeline.lanes is 8, and only floats"),
        (("FILE", "--draw", f"{RATE}=3"), "expected a range such as"),
        (("--resume", "nowhere"), "nowhere does not exist"),
        (("--report", "nowhere"), "nowhere does not exist"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_two(call, file, arguments, message):
    code, printed, errors = call(*[file if x == "FILE" else x for x in arguments])
    assert (code, printed) == (2, "")
    assert errors.startswith("jaxact.sweep: ")
    assert message in errors
    assert errors.count("\n") == 1


def test_help_lists_every_flag(call):
    code, printed, _ = call("--help")
    assert code == 0
    assert "usage: python -m jaxact.sweep" in printed
    for field in dataclasses.fields(command_line.SweepArguments):
        if field.name != "experiment":
            assert f"--{field.name.replace('_', '-')}" in printed


@pytest.mark.slow
def test_neither_chunks_nor_neighbours_nor_seeds_matter():
    """With two stages; to the last bits of batched sums."""
    space = SearchSpace.of({RATE: uniform(1e-3, 2e-2), f"{FORCING}.start": uniform(0.5, 1.0)})
    found = []
    for chunk, seeds in ((3, (0,)), (2, (0,)), (1, (0,)), (4, (0, 1))):
        options = SweepOptions(**SETTINGS | {"chunk": chunk, "seeds": seeds})
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Sweep, "_fitting_program", FITTING)
            records = Sweep(experiment(), space, options).run().records
        assert len(records) == 3 * len(seeds)
        found.append([x["evaluations"] for x in records if x["seed"] == 0])
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            for mine, its in zip(one, other, strict=True):
                assert mine == pytest.approx(its, rel=0.02)


DEVICES = """
    import json, sys
    import jax
    from jaxact import sweep
    from jaxact.search_space import uniform
    from tests.tiny import experiment

    space = {"pipeline.learning_rate.start": uniform(1e-3, 2e-2)}
    found = {}
    for devices in (1, 2):
        options = {"draws": 3, "evaluations": 1, "evaluation_episodes": 40, "progress": False}
        result = sweep(experiment(), space, devices=devices, **options)
        found[devices] = [record["evaluations"] for record in result.records]
    print(json.dumps(found))
"""


@pytest.mark.slow
def test_runs_are_sharded_over_devices():
    ended = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(DEVICES)],
        env=os.environ | {"JAX_NUM_CPU_DEVICES": "2"},
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    for (one,), (other,) in zip(found["1"], found["2"], strict=True):
        assert one == pytest.approx(other, rel=0.02)
