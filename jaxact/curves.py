"""The curves of a run, read from its files: every metric against environment steps."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import JaxactError
from jaxact.logs import METRICS, read_hours, read_metrics
from jaxact.runs import CONFIG, open_run, read_config

EVALUATION = "evaluation"
_RESULT = {"name", "fingerprint", "runs"}


@dataclass(frozen=True)
class Curve:
    """One metric of one run; arrays are float64[n].

    Attributes:
      step: environment steps, increasing.
      value: the metric; NaN where it was not logged between steps at which it was, as that of a
        loss in a stage without it: no line crosses such a gap.
      low: lower end of the 95 % interval over episodes that an evaluation recorded, else NaN.
      high: its upper end.
    """

    step: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def smoothed(self, window: float) -> Curve:
        """Returns the means over the points at most half a window away, within gaps' bounds."""
        value = self.value.copy()
        for part in np.split(np.arange(len(value)), np.flatnonzero(np.isnan(value))):
            part = part[~np.isnan(value[part])]
            step = self.step[part]
            sums = np.concatenate([[0.0], np.cumsum(self.value[part])])
            first = np.searchsorted(step, step - window / 2, "left")
            end = np.searchsorted(step, step + window / 2, "right")
            value[part] = (sums[end] - sums[first]) / (end - first)
        unknown = np.full_like(value, np.nan)
        return Curve(self.step, value, unknown, unknown)


@dataclass(frozen=True)
class RunCurves:
    """What one run logged.

    Attributes:
      path: the run's directory, or the file of a committed result.
      name: the experiment's.
      fingerprint: of the experiment.
      seed: of everything random.
      experiment: the experiment's values as in `config.json`; of a committed result none.
      curves: by metric: the tags of `metrics.jsonl`; "evaluation/success" and its like of the
        evaluations during training, "evaluation-seed3-greedy/success" of those made afterwards.
    """

    path: Path
    name: str
    fingerprint: str
    seed: int
    experiment: Mapping[str, Any]
    curves: dict[str, Curve] = field(repr=False)

    @property
    def last_step(self) -> float:
        """The last step of which something is known."""
        return max((float(curve.step[-1]) for curve in self.curves.values()), default=0.0)

    def hours(self, step: np.ndarray) -> np.ndarray:
        """Returns the hours that the run took to come to given steps.

        Raises:
          JaxactError: it kept no TensorBoard events, which have them.
        """
        return np.interp(step, *self._hours)

    @cached_property
    def _hours(self) -> tuple[np.ndarray, np.ndarray]:
        return read_hours(self.path)


def find_runs(paths: Iterable[str | Path]) -> list[Path]:
    """Returns runs' directories and results' files, each once, in the order given.

    Args:
      paths: runs, directories with runs somewhere inside, or files such as those in
        `docs/results`.

    Raises:
      JaxactError: there is no run in one of them.
    """
    found: dict[Path, Path] = {}
    for path in map(Path, paths):
        inside = [path] if path.is_file() and path.suffix == ".json" else _runs_inside(path)
        for one in inside or [open_run(path)]:
            found.setdefault(one.resolve(), one)
    return list(found.values())


def read_curves(path: Path) -> list[RunCurves]:
    """Reads a run, or the runs of a file such as those in `docs/results`.

    A last line of `metrics.jsonl` that was cut short, as of a run that goes on, is left out.

    Returns:
      A run's curves; of a file those of each of its runs, nothing if it is not about runs.

    Raises:
      JaxactError: a file is damaged or lacks what says which experiment it is of.
    """
    return _read_result(path) if path.is_file() else [_read_run(path)]


def _runs_inside(path: Path) -> list[Path]:
    runs = []
    for directory, below, files in os.walk(path):
        below.sort()
        if CONFIG in files:
            runs.append(Path(directory))
            below.clear()  # a run's checkpoints have many directories and no runs
    return runs


def _read_run(path: Path) -> RunCurves:
    config = read_config(path)
    rows = read_metrics(path) if (path / METRICS).is_file() else []
    curves = _logged(rows, path / METRICS)
    records: dict[str, list[dict[str, Any]]] = {}
    for file in sorted((path / EVALUATION).glob("*.json")):
        record = _read_json(file)
        if "overrides" not in record:  # of other worlds than the run's own
            _, dash, conditions = file.stem.partition("-")
            records.setdefault(EVALUATION + dash + conditions, []).append(record)
    for prefix, those in records.items():
        curves |= _evaluated(those, prefix)
    try:
        experiment = config["experiment"]
        identity = experiment["name"], config["fingerprint"], config["seed"]
    except (KeyError, TypeError):
        raise JaxactError(
            f"{path / CONFIG} is not of a training run: it lacks seed, fingerprint or experiment"
        ) from None
    return RunCurves(path, *identity, experiment, curves)


def _read_result(path: Path) -> list[RunCurves]:
    result = _read_json(path)
    if not isinstance(result, dict) or not result.keys() >= _RESULT:
        return []
    read = []
    for run in result["runs"]:
        columns = [[(name, x) for x in column] for name, column in run["curve"].items()]
        curves = _logged([dict(row) for row in zip(*columns, strict=True)], path)
        curves |= _evaluated(run["evaluations"], EVALUATION)
        identity = result["name"], result["fingerprint"], run["seed"]
        read.append(RunCurves(path, *identity, {}, curves))
    return read


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise JaxactError(f"{path} is not valid JSON: {error}") from None


def _logged(rows: Sequence[Mapping[str, float]], source: Path) -> dict[str, Curve]:
    """Returns the curves of lines of metrics."""
    if any("step" not in row for row in rows):
        raise JaxactError(f"{source} has lines without 'step'")
    # Evaluations are lines of their own; their files say more.
    by_step = {row["step"]: row for row in rows if not any(_of_evaluation(tag) for tag in row)}
    rows = [by_step[step] for step in sorted(by_step)]
    curves = {}
    for tag in dict.fromkeys(tag for row in rows for tag in row if tag != "step"):
        at = [index for index, row in enumerate(rows) if tag in row]
        # A line without the metric is a gap; one where it is NaN had no episode to tell of.
        between = rows[at[0] : at[-1] + 1]
        points = [(r["step"], r.get(tag)) for r in between if not math.isnan(r.get(tag, 0.0))]
        values = [math.nan if value is None else value for _, value in points]
        if not np.isnan(values).all():
            curves[tag] = _curve([step for step, _ in points], values)
    return curves


def _of_evaluation(tag: str) -> bool:
    return tag.startswith(f"{EVALUATION}/")


def _evaluated(records: Iterable[Mapping[str, Any]], prefix: str) -> dict[str, Curve]:
    """Returns the curves of evaluations' summaries."""
    points: dict[str, list[tuple[float, ...]]] = {}
    for record in sorted(records, key=lambda record: record["step"]):
        for name, value in record.items():
            if isinstance(value, dict):
                point = (record["step"], value["mean"], *value["interval"])
                points.setdefault(f"{prefix}/{name}", []).append(point)
    return {name: _curve(*zip(*those, strict=True)) for name, those in points.items()}


def _curve(
    step: Sequence[float],
    value: Sequence[float],
    low: Sequence[float] | None = None,
    high: Sequence[float] | None = None,
) -> Curve:
    unknown = [math.nan] * len(step)
    columns = (step, value, unknown if low is None else low, unknown if high is None else high)
    return Curve(*(np.asarray(column, np.float64) for column in columns))
