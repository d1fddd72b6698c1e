"""What random searches can expect: the best of k draws against k, as a table and as a figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import JaxactError, unknown
from jaxact.statistics import expected_best, expected_best_interval
from jaxact.sweep_records import Record, read_records, read_sweep_config

# Numbers of draws in the table, as far as there are so many.
_SHOWN = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
# In the figure, each number of draws up to here.
_EACH = 50
_SUFFIXES = (".png", ".svg")


@dataclass(frozen=True)
class Curve:
    """The expected best of k of n draws.

    Attributes:
      name: of the sweep.
      scores: float64 [n], of each draw.
      points: by k: the expected best, and the ends of its 95 % bootstrap interval.
    """

    name: str
    scores: np.ndarray
    points: dict[int, tuple[float, float, float]]


def report(
    sweeps: Sequence[Path],
    metric: str = "success",
    smallest: bool = False,
    figure: Path | None = None,
) -> str:
    """Compares sweeps and draws one figure of them.

    Args:
      sweeps: directories.
      metric: what is best at the last evaluation.
      smallest: the smallest is the best.
      figure: where to draw, with the suffixes .png and .svg; None means `expected_best` in the
        first sweep's directory.

    Returns:
      A table, each sweep's best draw, and where the figure is.

    Raises:
      JaxactError: a directory is no sweep, nothing is finished there, or there is no such metric.
    """
    curves, lines = [], []
    for directory in sweeps:
        config, records = read_sweep_config(directory), read_records(directory)
        if not records:
            raise JaxactError(f"{directory} has no finished run yet")
        scores = draw_scores(records, metric, smallest)
        curves.append(expected_best_curve(_name(directory, config, sweeps), scores, smallest))
        lines.append(_best_draw(curves[-1], records, smallest))
    path = figure or Path(sweeps[0]) / "expected_best"
    drawn = draw_curves(curves, metric, smallest, path)
    table = _table(curves, metric, smallest)
    return "\n".join([*table, "", *lines, f"figure: {', '.join(map(str, drawn))}"])


def draw_scores(
    records: Sequence[Record], metric: str = "success", smallest: bool = False
) -> np.ndarray:
    """Returns the metric at the last evaluation of each draw, float64 [n]; means over its seeds.

    A value that was not finite counts as the worst of those that were.

    Args:
      records: of a sweep.
      metric: a name in the records' evaluations.
      smallest: whether the smallest is the best.

    Raises:
      JaxactError: there is no such metric, or it is never finite.
    """
    last = [record["evaluations"][-1] for record in records]
    known = {name for evaluation in last for name in evaluation} - {"step"}
    if metric not in known:
        raise unknown("metric", metric, known)
    values = np.array([math.nan if (x := e.get(metric)) is None else x for e in last], np.float64)
    if np.isnan(values).all():
        raise JaxactError(f"{metric} was finite in none of the {len(values)} runs")
    worst = np.nanmax(values) if smallest else np.nanmin(values)
    values = np.where(np.isnan(values), worst, values)
    draws = np.array([record["draw"] for record in records])
    return np.array([values[draws == draw].mean() for draw in np.unique(draws)])


def expected_best_curve(name: str, scores: np.ndarray, smallest: bool = False) -> Curve:
    """Returns the expected best of few and of some more draws, up to all of them."""
    most = len(scores)
    counts = sorted(k for k in {*range(1, _EACH + 1), *_SHOWN, most} if k <= most)
    points = {}
    for k in counts:
        low, high = expected_best_interval(scores, k, smallest=smallest)
        points[k] = (expected_best(scores, k, smallest=smallest), low, high)
    return Curve(name, scores, points)


def _name(directory: Path, config: dict[str, Any], sweeps: Sequence[Path]) -> str:
    """The experiment's name, and the directory's where others are of the same experiment."""
    name = config["experiment"]["name"]
    names = [read_sweep_config(other)["experiment"]["name"] for other in sweeps]
    return name if names.count(name) == 1 else f"{name} {Path(directory).name}"


def _table(curves: Sequence[Curve], metric: str, smallest: bool) -> list[str]:
    most = max(len(curve.scores) for curve in curves)
    counts = sorted({k for k in _SHOWN if k <= most} | {most})
    width = max(len("draws"), *(len(curve.name) for curve in curves))
    which = "smallest" if smallest else "largest"
    lines = [f"expected {which} {metric} of k draws [95 % bootstrap interval]"]
    lines.append("  ".join(["k".ljust(width), *(str(k).rjust(22) for k in counts)]))
    for curve in curves:
        cells = [
            "{:.3f} [{:.3f}, {:.3f}]".format(*curve.points[k]) if k in curve.points else "-"
            for k in counts
        ]
        lines.append("  ".join([curve.name.ljust(width), *(cell.rjust(22) for cell in cells)]))
    return lines


def _best_draw(curve: Curve, records: Sequence[Record], smallest: bool) -> str:
    numbers = {record["draw"]: record["numbers"] for record in records}
    diverged = {record["draw"] for record in records if record["diverged"] is not None}
    draws = sorted(numbers)
    index = int(np.argmin(curve.scores) if smallest else np.argmax(curve.scores))
    settings = " ".join(f"--set {path}={x:.9g}" for path, x in numbers[draws[index]].items())
    return (
        f"{curve.name}: {len(draws)} draws, {len(diverged)} diverged; the best is draw "
        f"{draws[index]} with {curve.scores[index]:.3f}: {settings}"
    )


def draw_curves(curves: Sequence[Curve], metric: str, smallest: bool, path: Path) -> list[Path]:
    """Draws what searches can expect of k draws.

    Args:
      curves: of the sweeps.
      metric: what is best, for the axis.
      smallest: whether the smallest is the best.
      path: where to, with the suffixes .png and .svg.

    Returns:
      The files.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for curve in curves:
        expected, low, high = zip(*curve.points.values(), strict=True)
        (line,) = axes.plot(list(curve.points), expected, label=curve.name)
        axes.fill_between(list(curve.points), low, high, color=line.get_color(), alpha=0.15)
    which = "smallest" if smallest else "largest"
    axes.set(xlabel="draws k", ylabel=f"expected {which} {metric} of k draws")
    axes.set_title("Random search; bands: 95 % bootstrap over draws", fontsize="medium")
    axes.grid(alpha=0.3)
    axes.legend()
    bare = path.with_suffix("") if path.suffix in _SUFFIXES else path
    paths = [bare.with_name(f"{bare.name}{suffix}") for suffix in _SUFFIXES]
    path.parent.mkdir(parents=True, exist_ok=True)
    for one in paths:
        figure.savefig(one, dpi=130)
    plt.close(figure)
    return paths
