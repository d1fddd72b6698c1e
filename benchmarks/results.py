"""Turns finished runs into `docs/results/<experiment>.json` and one figure of their curves.

Run `python -m benchmarks.results RUN [RUN ...]`: the runs of an experiment, which differ in the
seed, become a file with the commit, versions, the mean over seeds, the steps at which success was
first at 97 and 99 %, and of each run the command that makes it, the training curve and the held-out
evaluations with their intervals; `docs/results/<figure>.png` and `.svg` show success, or another
metric, against steps for all of them.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from jaxact.errors import JaxactError
from jaxact.statistics import mean_interval

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results"
CURVE_POINTS = 60
SHOWN = ("train/success", "train/return", "train/length", "train/task/spl")
# Shares of success of which it is told when an evaluation first had them.
MILESTONES = (0.97, 0.99)


@dataclass(frozen=True)
class Arguments:
    """Writes results and a figure."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Directories of finished runs."""
    commit: str
    """The commit they were trained at."""
    figure: str = "gotolocal"
    """Name of the figure."""
    metric: str = "success"
    """What the figure shows, of evaluations and of training."""
    output: Path = RESULTS
    """Directory to write to."""


def main() -> None:
    """Parses the command line and writes the files."""
    from jaxact.plot import plot_runs

    arguments = tyro.cli(Arguments)
    arguments.output.mkdir(parents=True, exist_ok=True)
    files = []
    for result in results_of(arguments.runs, arguments.commit):
        files.append(arguments.output / f"{result['name']}.json")
        files[-1].write_text(json.dumps(result, indent=1) + "\n")
        print(files[-1], json.dumps({name: result[name] for name in ("final", "first_at")}))
    shown = f"evaluation/{arguments.metric}+train/{arguments.metric}"
    figure = plot_runs(files, metrics=(shown,))
    print(*figure.save(arguments.output / f"{arguments.figure}.png"))


def results_of(runs: Iterable[Path], commit: str) -> list[dict[str, Any]]:
    """Describes finished runs, those of an experiment together and in the order of their seeds.

    Raises:
      JaxactError: two runs have the same experiment's name but not its values, or the same seed.
    """
    from jaxact.runs import read_config

    experiments: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    for run in runs:
        config = read_config(run)
        experiments.setdefault(config["experiment"]["name"], []).append((run, config))
    results = []
    for name, those in experiments.items():
        those.sort(key=lambda one: one[1]["seed"])
        seeds = [config["seed"] for _, config in those]
        prints = {config["fingerprint"] for _, config in those}
        if len(prints) > 1 or len(set(seeds)) < len(seeds):
            raise JaxactError(
                f"the runs of {name} should differ in the seed and in nothing else; they have "
                f"{len(prints)} sets of values and seeds {seeds}"
            )
        described = [_described(run, config) for run, config in those]
        results.append(
            {
                "name": name,
                "commit": commit,
                "fingerprint": prints.pop(),
                "versions": json.loads((those[0][0] / "versions.json").read_text()),
                "seeds": seeds,
                "final": _over_seeds([run["evaluations"][-1] for run in described]),
                "first_at": {
                    str(share): [_first_at(run["evaluations"], share) for run in described]
                    for share in MILESTONES
                },
                "runs": described,
            }
        )
    return results


def _described(run: Path, config: dict[str, Any]) -> dict[str, Any]:
    from jaxact.logs import read_metrics

    rows = [row for row in read_metrics(run) if "evaluation/success" not in row]
    stride = max(1, len(rows) // CURVE_POINTS)
    # Who learns from demonstrations alone has no episodes of its own.
    shown = [name for name in SHOWN if all(name in row for row in rows)]
    evaluations = [json.loads(p.read_text()) for p in sorted((run / "evaluation").glob("*.json"))]
    options = "".join(f" --set {text}" for text in config["overrides"])
    trained = int(rows[-1]["step"])
    if trained < sum(stage["steps"] for stage in config["experiment"]["pipeline"]["stages"]):
        options += f" --total-steps {trained}"
    return {
        "command": f"python -m jaxact.train {_name(config['source'])} "
        f"--seed {config['seed']}{options}",
        "seed": config["seed"],
        "trained_steps": trained,
        "curve": {
            "step": [row["step"] for row in rows[::stride]],
            **{name: [round(row[name], 5) for row in rows[::stride]] for name in shown},
        },
        "evaluations": evaluations,
    }


def _name(source: str) -> str:
    """Returns what a run of an example is started by: its name, or its file and what was chosen."""
    return f"examples/{source}" if ":" in source else Path(source).stem


def _first_at(evaluations: list[dict[str, Any]], share: float) -> int | None:
    """Returns the steps at the first evaluation with such a share of success, None without one."""
    steps = (e["step"] for e in evaluations if e["success"]["mean"] >= share)
    return next(steps, None)


def _over_seeds(evaluations: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns the means over seeds of the last evaluations, with Student's 95 % intervals; of one
    seed the interval over episodes.
    """
    final: dict[str, Any] = {"step": evaluations[0]["step"]}
    for name in SHOWN:
        short = name.partition("/")[2]
        if any(short not in evaluation for evaluation in evaluations):
            continue
        values = [evaluation[short]["mean"] for evaluation in evaluations]
        interval = evaluations[0][short]["interval"] if len(values) == 1 else mean_interval(values)
        final[short] = {"mean": statistics.fmean(values), "each": values, "interval": interval}
    return final


if __name__ == "__main__":
    main()
