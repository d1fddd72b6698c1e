"""Evaluating what was trained: `python -m jaxact.evaluate RUN`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError
from jaxact.evaluation import evaluate_expert, evaluate_policy
from jaxact.experiment import Experiment
from jaxact.features import check_names
from jaxact.loading import load_experiment
from jaxact.overrides import override
from jaxact.policy import Policy
from jaxact.recording import record_episode
from jaxact.runs import open_run, read_config, write_json
from jaxact.train_state import init_params, make_key
from jaxact.video import write_video


def load_run(run: str | Path, overrides: Sequence[str] = ()) -> Experiment:
    """Returns the experiment of a run, from the run's own copy of its source.

    Raises:
      JaxactError: it is no run, or its source is gone.
    """
    path = open_run(run)
    config = read_config(path)
    if "source" not in config:
        raise JaxactError(
            f"{path} was trained from Python and keeps no source: load it there with load_policy"
        )
    experiment, _ = load_experiment(str(path / "source" / config["source"]))
    return override(override(experiment, config["overrides"]), overrides)


def load_policy(
    run: str | Path, experiment: Experiment | None = None, step: int | None = None
) -> Policy:
    """Returns the policy of a run's checkpoint.

    Args:
      run: the run's directory.
      experiment: what was trained; by default the run's own copy.
      step: of the checkpoint; None means the newest that can be read.

    Raises:
      JaxactError: there is no such run or checkpoint, or it is damaged.
    """
    path = open_run(run)
    experiment = experiment or load_run(path)
    like = jax.eval_shape(lambda: init_params(experiment, make_key(0)))
    params = Checkpoints(path / "checkpoints").restore_part(step, "params", like).state
    return Policy(experiment.model, params, experiment.pomdp.action_space)


def choose_checkpoints(run: str | Path, which: str) -> list[int]:
    """Returns the steps of a run's checkpoints: "newest", "best", "all" or one step.

    Raises:
      JaxactError: there is no such run or checkpoint.
    """
    checkpoints = Checkpoints(open_run(run) / "checkpoints")
    steps = checkpoints.steps()
    if not steps:
        raise JaxactError("the run has no checkpoints yet")
    match which:
        case "newest":
            return steps[-1:]
        case "best":
            best = checkpoints.best()
            return steps[-1:] if best is None else [best]
        case "all":
            return steps
    if which.isdigit() and int(which) in steps:
        return [int(which)]
    raise JaxactError(
        f"there is no checkpoint {which!r}; choose newest, best, all or one of "
        f"{', '.join(map(str, steps))}"
    )


def evaluate_run(
    run: str | Path,
    *,
    overrides: Sequence[str] = (),
    checkpoint: str = "newest",
    episodes: int = 1000,
    seed: int = 0,
    greedy: bool = False,
    video: Path | None = None,
    features: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Evaluates checkpoints of a run and writes `evaluation/*.json` into it.

    Args:
      run: the run's directory.
      overrides: changes of the experiment ("path=value"), such as another world to evaluate in.
      checkpoint: "newest", "best", "all" or a step.
      episodes: held-out episodes, each played once.
      seed: of the episodes.
      greedy: take the most likely actions.
      video: film the last of these checkpoints on the first held-out episode, into this file.
      features: names of the model's intermediates that the film shows; see `jaxact.features`.

    Returns:
      A summary for each checkpoint, with 95 % confidence intervals.

    Raises:
      JaxactError: there is no such run, checkpoint or intermediate, or no film to show it in.
    """
    if features and video is None:
        raise JaxactError(f"{', '.join(features)} can be shown in a film only: name its file")
    path = open_run(run)
    trained, experiment = load_run(path), load_run(path, overrides)
    results = []
    for step in choose_checkpoints(path, checkpoint):
        policy = load_policy(path, trained, step)
        check_names(experiment.pomdp, policy, features)
        outcome = evaluate_policy(experiment.pomdp, policy, episodes, seed=seed, greedy=greedy)
        summary = {"step": step, "seed": seed, "greedy": greedy, **outcome.summary()}
        if overrides:
            summary["overrides"] = list(overrides)
        name = f"{step:012d}-seed{seed}-{'greedy' if greedy else 'sampled'}.json"
        (path / "evaluation").mkdir(exist_ok=True)
        write_json(path / "evaluation" / name, summary)
        print_summary(f"step {step:,}", summary)
        results.append(summary)
    if video is not None:
        frames = record_episode(
            experiment.pomdp, policy, seed=seed, greedy=greedy, features=features
        )
        write_video(video, frames)
    return results


def report_expert(name: str, overrides: Sequence[str], episodes: int, seed: int) -> dict[str, Any]:
    """Evaluates the expert of an experiment (or of a run's) and prints the result."""
    is_run = (Path(name) / "config.json").is_file()
    experiment = load_run(name) if is_run else load_experiment(name)[0]
    pomdp = override(experiment, overrides).pomdp
    summary = evaluate_expert(pomdp, episodes, seed=seed).summary()
    print_summary("expert", summary)
    return summary


def print_summary(title: str, summary: dict[str, Any]) -> None:
    """Prints means with their 95 % confidence intervals."""
    print(f"{title}: {summary['episodes']} held-out episodes, mean [95 % interval]")
    for name, value in summary.items():
        if isinstance(value, dict):
            low, high = value["interval"]
            print(f"  {name:20} {value['mean']:.4f} [{low:.4f}, {high:.4f}]")


if __name__ == "__main__":
    from jaxact.command_line import run_evaluate

    run_evaluate()
