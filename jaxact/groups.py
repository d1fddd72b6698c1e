"""Runs of one experiment brought together: what their seeds' curves have in common."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from jaxact.curves import Curve, RunCurves
from jaxact.errors import JaxactError
from jaxact.statistics import mean_interval

Statistic = Literal["median", "mean"]


@dataclass(frozen=True)
class Group:
    """Runs that differ in nothing but the seed.

    Attributes:
      label: what the legend calls them.
      runs: one for each seed.
    """

    label: str
    runs: tuple[RunCurves, ...]


@dataclass(frozen=True)
class Band:
    """A curve of several seeds; arrays are float64[n].

    Attributes:
      x: where all seeds are known, NaN-free and increasing.
      line: median or mean over seeds; NaN in gaps.
      low: lower end of the band, NaN where there is none.
      high: its upper end.
      spread: what the band is of: "seeds", or "episodes" of a single seed's evaluations, or
        "nothing".
    """

    x: np.ndarray
    line: np.ndarray
    low: np.ndarray
    high: np.ndarray
    spread: Literal["seeds", "episodes", "nothing"]


def group_runs(runs: Iterable[RunCurves], labels: Sequence[str] = ()) -> tuple[list[Group], int]:
    """Puts the runs of each experiment together, by name and fingerprint.

    Of runs with the same seed, which say the same twice, the one that came farthest is taken.

    Args:
      runs: in the order in which the groups are to be.
      labels: of the groups; by default the experiments' names, with what tells them apart.

    Returns:
      The groups, and how many runs were left out as others had their seeds.

    Raises:
      JaxactError: there are not as many labels as groups.
    """
    seeds: dict[tuple[str, str], dict[int, RunCurves]] = {}
    count = 0
    for run in runs:
        count += 1
        those = seeds.setdefault((run.name, run.fingerprint), {})
        if run.seed not in those or run.last_step >= those[run.seed].last_step:
            those[run.seed] = run
    groups = [tuple(those[seed] for seed in sorted(those)) for those in seeds.values()]
    names = list(labels) or _labels([group[0] for group in groups])
    if len(names) != len(groups):
        found = ", ".join(f"{group[0].name} ({len(group)} seeds)" for group in groups)
        raise JaxactError(f"{len(names)} labels for {len(groups)} experiments: {found}")
    made = [Group(name, group) for name, group in zip(names, groups, strict=True)]
    return made, count - sum(map(len, groups))


def band(curves: Sequence[Curve], statistic: Statistic) -> Band | None:
    """Summarises the seeds' curves of one metric.

    The seeds may have been logged at different steps: each is interpolated linearly at the steps of
    all. Nothing is made up before a seed's first step, beyond its last one or in its gaps: there
    the band has no value either.

    Args:
      curves: one for each seed.
      statistic: "median" with the quartiles, or "mean" with Student's 95 % interval.

    Returns:
      The band; None if there is no step at which all seeds are known.
    """
    first = max(curve.step[0] for curve in curves)
    last = min(curve.step[-1] for curve in curves)
    grid = np.unique(np.concatenate([curve.step for curve in curves]))
    grid = grid[(first <= grid) & (grid <= last)]
    values = np.stack([np.interp(grid, curve.step, curve.value) for curve in curves])
    known = np.isfinite(values).all(0)
    if not known.any():
        return None
    line, low, high = np.full((3, len(grid)), np.nan)
    spread: Literal["seeds", "episodes", "nothing"] = "seeds"
    if len(curves) == 1:
        line, low, high = values[0], curves[0].low, curves[0].high
        spread = "episodes" if np.isfinite(low).any() else "nothing"
    elif statistic == "median":
        quartiles = np.quantile(values[:, known], (0.25, 0.5, 0.75), axis=0)
        low[known], line[known], high[known] = quartiles
    else:
        line[known] = values[:, known].mean(0)
        low[known], high[known] = zip(*map(mean_interval, values[:, known].T), strict=True)
    return Band(grid, line, low, high, spread)


def _labels(runs: Sequence[RunCurves]) -> list[str]:
    """Names runs of different experiments; those of one name with what tells them apart."""
    labels = []
    for run in runs:
        namesakes = [_leaves(other.experiment) for other in runs if other.name == run.name]
        own = _leaves(run.experiment)
        paths = sorted({path for one in namesakes for path in one})
        differing = [
            p for p in paths if any(one.get(p) != namesakes[0].get(p) for one in namesakes)
        ]
        if len(namesakes) == 1:
            labels.append(run.name)
        elif 1 <= len(differing) <= 2:
            ends = [path.rpartition(".")[2] for path in differing]
            shown = ends if len(set(ends)) == len(ends) else differing
            pairs = zip(shown, differing, strict=True)
            told = ", ".join(f"{name}={own.get(path)}" for name, path in pairs)
            labels.append(f"{run.name}, {told}")
        else:
            labels.append(f"{run.name} ({run.fingerprint[:7]})")
    return labels


def _leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Returns the values of nested JSON by dotted path."""
    if isinstance(value, list):
        value = {str(index): part for index, part in enumerate(value)}
    if not isinstance(value, Mapping):
        return {path: value}
    parts = (_leaves(part, f"{path}.{key}" if path else key) for key, part in value.items())
    return {name: leaf for part in parts for name, leaf in part.items()}
