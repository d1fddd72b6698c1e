"""Turns finished runs into `docs/results/<experiment>.json` and one figure of their curves.

Run `python -m benchmarks.results RUN [RUN ...]`: each run becomes a file with the command that
makes it, the commit, the seed, versions, the training curve and the held-out evaluations with their
intervals; `docs/results/<figure>.png` and `.svg` show success against steps for all of them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results"
CURVE_POINTS = 60


@dataclass(frozen=True)
class Arguments:
    """Writes results and a figure."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Directories of finished runs."""
    commit: str
    """The commit they were trained at."""
    figure: str = "gotolocal"
    """Name of the figure."""
    output: Path = RESULTS
    """Directory to write to."""


def main() -> None:
    """Parses the command line and writes the files."""
    from jaxact.plot import plot_runs

    arguments = tyro.cli(Arguments)
    arguments.output.mkdir(parents=True, exist_ok=True)
    files = []
    for run in arguments.runs:
        result = result_of(run, arguments.commit)
        files.append(arguments.output / f"{result['name']}.json")
        files[-1].write_text(json.dumps(result, indent=1) + "\n")
        print(files[-1])
    figure = plot_runs(files, metrics=("evaluation/success+train/success",))
    print(*figure.save(arguments.output / f"{arguments.figure}.png"))


def result_of(run: Path, commit: str) -> dict[str, Any]:
    """Describes a finished run."""
    from jaxact.logs import read_metrics
    from jaxact.runs import read_config

    config = read_config(run)
    rows = [row for row in read_metrics(run) if "train/success" in row]
    stride = max(1, len(rows) // CURVE_POINTS)
    shown = ("train/success", "train/return", "train/length")
    evaluations = [json.loads(p.read_text()) for p in sorted((run / "evaluation").glob("*.json"))]
    options = "".join(f" --set {text}" for text in config["overrides"])
    trained = int(rows[-1]["step"])
    if trained < sum(stage["steps"] for stage in config["experiment"]["pipeline"]["stages"]):
        options += f" --total-steps {trained}"
    return {
        "name": config["experiment"]["name"],
        "command": f"python -m jaxact.train {Path(config['source']).stem} "
        f"--seed {config['seed']}{options}",
        "trained_steps": trained,
        "commit": commit,
        "fingerprint": config["fingerprint"],
        "seeds": [config["seed"]],
        "versions": json.loads((run / "versions.json").read_text()),
        "curve": {
            "step": [row["step"] for row in rows[::stride]],
            **{n: [round(row[n], 5) for row in rows[::stride]] for n in shown},
        },
        "evaluations": evaluations,
        "final": evaluations[-1],
    }


if __name__ == "__main__":
    main()
