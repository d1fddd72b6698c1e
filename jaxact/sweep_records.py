"""The directory of a sweep: `config.json` and a line of `draws.jsonl` for each finished run."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxact.errors import JaxactError
from jaxact.experiment import Experiment
from jaxact.logs import complete_lines
from jaxact.overrides import fingerprint, to_json
from jaxact.runs import read_config
from jaxact.search_space import SearchSpace

DRAWS = "draws.jsonl"

Record = dict[str, Any]


def read_sweep_config(directory: str | Path) -> dict[str, Any]:
    """Returns the config of a sweep.

    Raises:
      JaxactError: it is no sweep's directory, or its config is damaged.
    """
    config = read_config(directory)
    if "space" not in config:
        raise JaxactError(f"{directory} is the run of a training, not a sweep")
    return config


def check_same(
    directory: Path, config: Mapping[str, Any], experiment: Experiment, space: SearchSpace
) -> None:
    """Checks that a sweep is that of an experiment and a space.

    Raises:
      JaxactError: it is of others.
    """
    mine, kept = fingerprint(to_json(experiment)), config["fingerprint"]
    if kept != mine:
        raise JaxactError(
            f"{directory} is a sweep of another experiment: {config['experiment']['name']!r} "
            f"({kept[:12]}), but this is {experiment.name!r} ({mine[:12]})"
        )
    if config["space"] != space.to_texts():
        there, here = (
            "; ".join(f"{paths}={value}" for paths, value in texts.items())
            for texts in (config["space"], space.to_texts())
        )
        raise JaxactError(f"{directory} draws {there}, but this sweep draws {here}")


def read_records(directory: str | Path) -> list[Record]:
    """Returns what a sweep has recorded, as `SweepResult.records`, in the order in which it ended.

    Raises:
      JaxactError: it is no sweep's directory, or a line is damaged.
    """
    read_sweep_config(directory)
    path = Path(directory) / DRAWS
    records = []
    for number, line in enumerate(complete_lines(path) if path.exists() else [], start=1):
        try:
            records.append(json.loads(line))
        except ValueError:
            raise JaxactError(f"{path}, line {number} is not valid JSON") from None
    return records


def append_records(directory: Path, records: Iterable[Record]) -> None:
    """Adds lines in one write; cuts off a last line first that was left unfinished."""
    path = directory / DRAWS
    if path.exists():
        with path.open("rb+") as file:
            file.truncate(sum(map(len, complete_lines(path))))
    with path.open("a", encoding="utf-8", newline="\n") as file:
        file.write("".join(json.dumps(record, allow_nan=False) + "\n" for record in records))
