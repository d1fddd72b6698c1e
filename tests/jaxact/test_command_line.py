"""`python -m jaxact.train`, `.evaluate` and `.collect`, as a person uses them.

They run in this process, so that programs are shared; two start one of their own.
"""

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from jaxact import command_line
from jaxact.checkpoints import Checkpoints
from jaxact.demonstrations import Demonstrations
from jaxact.options import Options
from jaxact.program import Program, choose_devices
from jaxact.runs import create_run
from jaxact.train_state import make_key
from tests.tiny import UPDATE

FILE = "from tests.tiny import experiment as make\n\nexperiment = make()\n"
QUICK = ("--no-progress", "--log-every", "128", "--evaluation-episodes", "40")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("experiments") / "small.py"
    path.write_text(FILE)
    return str(path)


@pytest.fixture
def call(monkeypatch, capsys):
    """(program, arguments) -> (exit code, what was printed, what went to stderr)."""

    def run(program, *arguments):
        monkeypatch.setattr(sys, "argv", [program, *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            getattr(command_line, f"run_{program}")()
        printed = capsys.readouterr()
        return ended.value.code or 0, printed.out, printed.err

    return run


@pytest.fixture(scope="module")
def trained(file, tmp_path_factory):
    """A run with an override in it."""
    runs = tmp_path_factory.mktemp("runs")
    arguments = command_line.TrainArguments(
        experiment=file,
        seed=4,
        set=("pipeline.stages.1.losses.ppo.clip=0.2",),
        output=runs,
        progress=False,
        log_every=128,
        evaluation_episodes=40,
        evaluate_every=256,
        checkpoint_every=128,
        keep_last=10,
    )
    assert command_line._train(arguments) == 0
    (run,) = (runs / "corridor").iterdir()
    return run


def test_training_keeps_its_source_seed_and_overrides(trained):
    config = json.loads((trained / "config.json").read_text())
    assert config["seed"] == 4
    assert config["overrides"] == ["pipeline.stages.1.losses.ppo.clip=0.2"]
    assert config["experiment"]["pipeline"]["stages"][1]["losses"]["ppo"]["clip"] == 0.2
    assert (trained / "source" / config["source"]).read_text() == FILE


def test_training_says_where_the_run_is(call, file, tmp_path):
    code, printed, errors = call(
        "train", file, *QUICK, "--output", tmp_path, "--total-steps", "128"
    )
    (run,) = (tmp_path / "corridor").iterdir()
    assert (code, errors) == (0, "")
    assert printed.splitlines()[-1] == f"run: {run}"


def test_progress_is_one_line_at_a_time(call, file, tmp_path):
    quick = [x for x in QUICK if x != "--no-progress"]
    code, printed, _ = call("train", file, *quick, "--output", tmp_path, "--total-steps", "256")
    lines = printed.splitlines()
    assert code == 0
    assert lines[0] == "compiling"
    assert any(line.startswith("stage 0  256/256 steps") for line in lines)
    assert any("of 40 held-out episodes, return" in line for line in lines)
    assert all(len(line) < 250 for line in lines)


def test_a_run_is_resumed_from_its_own_copy(call, trained, tmp_path):
    """The experiment need not be named, nor its overrides or seed repeated."""
    run = tmp_path / "copy"
    shutil.copytree(trained, run)
    code, printed, errors = call("train", "--resume", run, *QUICK)
    assert (code, errors) == (0, "")
    assert printed.splitlines()[-1] == f"run: {run}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("FILE", "--set", "pipeline.stages.1.losses.ppo.clp=0.2"),
            "pipeline.stages.1.losses.ppo (PPO): unknown field 'clp'; the nearest is 'clip'",
        ),
        (("FILE", "--set", "pipeline.lanes=many"), "pipeline.lanes: expected "),
        (("FILE", "--set", "pipeline.lanes"), "expected path=value"),
        (("FILE", "--set", "pipeline.lanes=7"), "7 lanes do not divide into 2 minibatches"),
        (("FILE", "--devices", "64"), "64 devices were asked for, but jax sees"),
        (("FILE", "--log-every", "0"), "log_every must be at least 1, got 0"),
        (("babyai_gotolocall",), "unknown experiment 'babyai_gotolocall'; the nearest is"),
        (("nowhere.py",), "there is no file nowhere.py"),
        (("--resume", "nowhere/run"), "does not exist"),
        ((), "name an experiment to train, or a run to --resume"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_two(call, file, arguments, message, tmp_path):
    arguments = [file if x == "FILE" else x for x in arguments]
    code, printed, errors = call("train", *arguments, "--output", tmp_path)
    assert code == 2
    assert printed == ""
    assert errors.startswith("jaxact.train: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_dry_run_describes_and_trains_nothing(call, tmp_path):
    file, runs = tmp_path / "one_stage.py", tmp_path / "runs"
    file.write_text(FILE.replace("make()", "make(stages=make().pipeline.stages[1:])"))
    code, printed, errors = call(
        "train", file, "--dry-run", "--output", runs, "--set", "pipeline.discount=0.5"
    )
    assert (code, errors) == (0, "")
    assert not runs.exists()
    for line in (
        "  environment  Corridor(length=6)",
        "  sensor       vector: float32[12] in [0, 1]",
        "  pipeline.discount = 0.5",
        "  pipeline.stages.0.losses.ppo.clip = 0.1",
        "  pipeline.stages.0.weights = {}",
        "  pipeline.optimizer = optax._src.alias.adam",
        "  params/memory/recurrent                          float32[8, 24]",
        "stage 0: ppo",
        "  4 updates of 64 environment steps",
    ):
        assert line in printed.splitlines()
    # 12·16+16 encoder, 16·24+24 and 8·24+8 memory, 8·2+2 actor, 8+1 critic
    assert "  843 in all" in printed.splitlines()
    assert "FLOPs an environment step" in printed
    assert "on each" in printed


def test_evaluating_the_newest_checkpoint(call, trained):
    code, printed, errors = call("evaluate", trained, "--episodes", "30", "--seed", "3")
    assert (code, errors) == (0, "")
    assert printed.startswith("step 512: 30 held-out episodes, mean [95 % interval]\n  success  ")
    record = json.loads((trained / "evaluation" / f"{512:012d}-seed3-sampled.json").read_text())
    assert record["episodes"] == 30
    assert record["greedy"] is False


def test_evaluating_every_checkpoint_greedily(call, trained):
    code, printed, _ = call(
        "evaluate", trained, "--episodes", "20", "--greedy", "--checkpoint", "all"
    )
    assert code == 0
    titles = [line.split(":")[0] for line in printed.splitlines() if line.startswith("step")]
    assert titles == ["step 128", "step 256", "step 384", "step 512"]
    assert (trained / "evaluation" / f"{256:012d}-seed0-greedy.json").is_file()


def test_evaluating_a_chosen_checkpoint(call, trained):
    best = Checkpoints(trained / "checkpoints").best()
    for which, step in (("best", best), ("384", 384)):
        code, printed, _ = call("evaluate", trained, "--episodes", "20", "--checkpoint", which)
        assert code == 0
        assert printed.startswith(f"step {step}: ")
    code, printed, errors = call("evaluate", trained, "--checkpoint", "385")
    assert (code, printed) == (2, "")
    assert "choose newest, best, all or one of 128, 256, 384, 512" in errors


def test_evaluating_under_other_conditions(call, trained):
    """With one step for each episode hardly any can succeed."""
    code, printed, _ = call(
        "evaluate", trained, "--episodes", "40", "--set", "pomdp.sampler.horizon=1"
    )
    assert code == 0
    assert "  length               1.0000 [1.0000, 1.0000]" in printed.splitlines()


def test_evaluating_the_expert(call, file, trained):
    for name in (file, trained):
        code, printed, errors = call("evaluate", name, "--expert", "--episodes", "50")
        assert (code, errors) == (0, "")
        assert printed.startswith("expert: 50 held-out episodes")
        assert "  success              1.0000 [0.9287, 1.0000]" in printed.splitlines()


def test_evaluating_what_is_no_run(call, file, tmp_path):
    code, printed, errors = call("evaluate", tmp_path)
    assert (code, printed) == (2, "")
    assert errors.startswith("jaxact.evaluate: ")
    assert "has no config.json" in errors
    code, _, errors = call("evaluate", file, "--video", tmp_path / "film.gif")
    assert code == 2


GRID = """
import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import ActorCritic, BagOfWords, Concatenated, NoMemory

pomdp = envs_jax.make("MiniGrid-Empty-5x5-v0")
model = ActorCritic(pomdp.action_space, Concatenated({"mission": BagOfWords(4)}), NoMemory())
pipeline = TrainingPipeline((Stage({"ppo": PPO()}, steps=64),), lanes=4, rollout_length=4)
experiment = Experiment("empty", pomdp, model, pipeline)
"""


@pytest.mark.slow
def test_filming_an_episode(call, tmp_path):
    from PIL import Image

    file = tmp_path / "empty.py"
    file.write_text(GRID)
    from jaxact.loading import load_experiment

    experiment, _ = load_experiment(str(file))
    run = create_run(tmp_path, "empty", {"seed": 0, "overrides": [], "source": file.name}, file)
    state = Program(experiment, choose_devices(1)).start(make_key(0))
    Checkpoints(run / "checkpoints").save(0, state, metadata={})
    film = tmp_path / "film.gif"
    code, _, errors = call("evaluate", run, "--episodes", "4", "--video", film)
    assert (code, errors) == (0, "")
    with Image.open(film) as picture:
        assert picture.n_frames >= 1


def test_recording_the_policy_of_a_run(call, trained, tmp_path):
    command = (trained, "--checkpoint", "384", "--episodes", "40", "--output", tmp_path / "set")
    code, printed, errors = call("collect", *command, "--no-progress")
    assert (code, errors) == (0, "")
    assert printed.startswith(f"{tmp_path / 'set'}: 40 of 40 episodes played, ")
    actor = Demonstrations(tmp_path / "set").description.actor
    assert actor["run"] == f"corridor/{trained.name}"
    assert (actor["kind"], actor["checkpoint"], actor["greedy"]) == ("policy", 384, False)
    assert call("collect", *command)[0] == 0
    code, _, errors = call("collect", *command, "--seed", "1")
    assert code == 2
    assert errors.startswith("jaxact.collect: ")
    assert "its seed is 0, but 1 was asked for" in errors


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--checkpoint", "best", "--expert"), "--expert and --checkpoint exclude each other"),
        (("--greedy",), "--greedy is for the policy of a --checkpoint"),
        (("--checkpoint", "all"), "one checkpoint at a time: newest, best or a step"),
        (("--checkpoint", "385"), "choose newest, best, all or one of 128, 256, 384, 512"),
    ],
)
def test_recording_what_cannot_be(call, trained, arguments, message, tmp_path):
    directory = tmp_path / "set"
    code, printed, errors = call(
        "collect", trained, "--episodes", "9", "--output", directory, *arguments
    )
    assert (code, printed) == (2, "")
    assert message in errors
    assert not directory.exists()


@pytest.mark.parametrize("program", ["train", "evaluate", "collect"])
def test_help_lists_every_flag(call, program):
    code, printed, _ = call(program, "--help")
    assert code == 0
    arguments = getattr(command_line, f"{program.capitalize()}Arguments")
    names = {f.name for f in dataclasses.fields(arguments)} - {"experiment", "run", "name"}
    for name in names:
        assert f"--{name.replace('_', '-')}" in printed
    assert f"usage: python -m jaxact.{program}" in printed


def test_every_option_of_python_is_one_of_the_command_line():
    there = {f.name for f in dataclasses.fields(command_line.TrainArguments)}
    assert {f.name for f in dataclasses.fields(Options)} <= there


def start(*arguments):
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
    )


def test_as_a_process_bad_input_leaves_no_traceback(file):
    ended = start("jaxact.train", file, "--set", "pipelin.lanes=16")
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr == (
        "jaxact.train: Experiment: unknown field 'pipelin'; the nearest is 'pipeline' "
        "(valid: model, name, pipeline, pomdp)\n"
    )


@pytest.mark.slow
def test_as_processes_train_resume_and_evaluate(file, tmp_path):
    environment = ("--output", str(tmp_path), *QUICK)
    ended = start("jaxact.train", file, *environment, "--compilation-cache")
    assert ended.returncode == 0, ended.stderr
    run = ended.stdout.strip().removeprefix("run: ")
    assert start("jaxact.train", "--resume", run, *QUICK).returncode == 0
    ended = start("jaxact.evaluate", run, "--episodes", "20")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith(f"step {8 * UPDATE}: 20 held-out episodes")
