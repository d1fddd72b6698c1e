"""Learning curves of runs: `python -m jaxact.plot RUN...`.

The runs of an experiment, which differ in the seed, become one line with a band.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxact.curves import EVALUATION, Curve, RunCurves, find_runs, read_curves
from jaxact.errors import JaxactError, unknown
from jaxact.figure import STYLE, Horizontal, draw, extent
from jaxact.groups import Band, Group, Statistic, band, group_runs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SUFFIXES = (".png", ".svg")


@dataclass(frozen=True)
class Final:
    """The last value of a group's curve.

    Attributes:
      experiment: the group's label.
      metric: its name.
      seeds: how many.
      x: environment steps, or hours, until then.
      value: the median or mean over seeds, or the value of the only one.
      low: lower end of the interval, None if there is none.
      high: its upper end.
      spread: what the interval is of: "seeds", "episodes" or "nothing".
    """

    experiment: str
    metric: str
    seeds: int
    x: float
    value: float
    low: float | None
    high: float | None
    spread: Literal["seeds", "episodes", "nothing"]


@dataclass(frozen=True)
class Plot:
    """A page of curves.

    Attributes:
      figure: matplotlib's.
      x: "steps" or "hours".
      statistic: "median" or "mean".
      finals: where the curves end.
      notes: sentences about what could not be drawn, or not all of it.
    """

    figure: Figure
    x: Horizontal
    statistic: Statistic
    finals: tuple[Final, ...]
    notes: tuple[str, ...]

    def save(self, output: str | Path) -> tuple[Path, Path]:
        """Writes the figure as PNG and SVG, the same bytes for the same curves.

        Args:
          output: the name of either; the other one goes beside it.

        Raises:
          JaxactError: the name ends otherwise, or cannot be written to.
        """
        import matplotlib as mpl

        output = check_output(output)
        png, svg = (output.with_suffix(suffix) for suffix in _SUFFIXES)
        try:
            output.parent.mkdir(parents=True, exist_ok=True)
            with mpl.rc_context(STYLE):
                self.figure.savefig(png, dpi=150)
                self.figure.savefig(svg, metadata={"Date": None})
        except OSError as error:
            raise JaxactError(f"cannot write {output}: {error.strerror}") from None
        return png, svg

    def table(self) -> str:
        """Returns the final values as text in columns."""
        band_of = "quartiles" if self.statistic == "median" else "95 %"
        kinds = {"seeds": f"{band_of} of seeds", "episodes": "95 % of episodes", "nothing": ""}
        heads = ("experiment", "metric", "seeds", self.x, self.statistic, "interval", "")
        rows: list[tuple[str, ...]] = [heads]
        for final in self.finals:
            x = f"{final.x:,.0f}" if self.x == "steps" else f"{final.x:.3f}"
            interval = "" if final.low is None else f"[{final.low:.4g}, {final.high:.4g}]"
            names = (final.experiment, final.metric, str(final.seeds), x)
            rows.append((*names, f"{final.value:.4g}", interval, kinds[final.spread]))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        numbers = ("seeds", self.x, self.statistic)
        columns = [
            [cell.rjust(width) if head in numbers else cell.ljust(width) for cell in column]
            for head, width, column in zip(heads, widths, zip(*rows, strict=True), strict=True)
        ]
        return "\n".join("  ".join(row).rstrip() for row in zip(*columns, strict=True))

    def to_json(self) -> dict[str, Any]:
        """Returns the final values for programs."""
        finals = [asdict(final) for final in self.finals]
        for final in finals:
            final[self.x] = final.pop("x")
        return {"statistic": self.statistic, "finals": finals}


def plot_runs(
    runs: Iterable[str | Path],
    *,
    metrics: Sequence[str] = (),
    statistic: Statistic = "median",
    smooth: float = 0,
    hours: bool = False,
    labels: Sequence[str] = (),
) -> Plot:
    """Draws runs' learning curves.

    A group's line and band end where its first seed ends; see `groups.band`. Held-out episodes of a
    single seed have the interval that their evaluation recorded, for success Wilson's.

    Args:
      runs: runs' directories, directories with runs inside, files such as those in `docs/results`.
      metrics: a panel for each, such as "train/return"; "evaluation/success+train/success" has both
        in one, the second thin. By default a page of what there is: success, return, components of
        the reward, teacher forcing, the losses' weights, losses. What never changes is left
        out, but for success.
      statistic: "median" with the quartiles over seeds, or "mean" with Student's 95 % interval.
      smooth: what was logged while training is averaged over so many environment steps.
      hours: whether curves are drawn against hours instead of environment steps.
      labels: of the experiments, in the order of the runs; by default their names.

    Raises:
      JaxactError: there is no run, or none with such a metric, or a file is damaged.
    """
    if not 0 <= smooth < math.inf:
        raise JaxactError(f"smooth must be a number of environment steps, got {smooth}")
    notes: list[str] = []
    groups, repeated = group_runs(_read(runs, notes), labels)
    if repeated:
        notes.append(f"runs left out, as others of the experiment had their seeds: {repeated}")
    notes += [*_unequal_ends(groups), *_unequal_stages(groups)]
    available = {name for group in groups for run in group.runs for name in run.curves}
    panels = [metric.split("+") for metric in metrics] or _default_panels(groups)
    for name in (name for panel in panels for name in panel):
        if name not in available:
            raise unknown("metric", name, available)
    bands: dict[tuple[int, str], Band] = {}
    for name in dict.fromkeys(name for panel in panels for name in panel):
        if metrics:  # on a page of what there is, losses come and go with the experiments
            notes += [f"{g.label} has no {name}" for g in groups if not _having(g, name)]
        drawn = _bands(groups, name, statistic, smooth, hours, notes)
        if not drawn and metrics:
            raise JaxactError(f"nothing to draw of {name}: {notes[-1]}")
        bands |= drawn
    panels = [panel for panel in panels if any(name in panel for _, name in bands)]
    finals = tuple(_final(groups[index], name, band) for (index, name), band in bands.items())
    x: Horizontal = "hours" if hours else "steps"
    figure = draw(groups, panels, bands, x, statistic, smooth)
    return Plot(figure, x, statistic, finals, tuple(notes))


def check_output(output: str | Path) -> Path:
    """Returns a figure's path.

    Raises:
      JaxactError: it is neither PNG's nor SVG's.
    """
    if Path(output).suffix not in _SUFFIXES:
        raise JaxactError(f"{output} should end in .png or .svg; both are written")
    return Path(output)


def _read(paths: Iterable[str | Path], notes: list[str]) -> Iterator[RunCurves]:
    """Reads the runs that logged something."""
    found, drawn = find_runs(paths), 0
    if not found:
        raise JaxactError("name at least one run, or a directory with runs in it")
    for path in found:
        runs = [run for run in read_curves(path) if run.curves]
        drawn += len(runs)
        yield from runs
        if not runs:
            notes.append(f"{path} left out, as it has no curves")
    if not drawn:
        raise JaxactError(f"nothing has been logged in {', '.join(map(str, found))}")


def _unequal_ends(groups: Iterable[Group]) -> Iterator[str]:
    for group in groups:
        ends = {run.seed: run.last_step for run in group.runs}
        first = min(ends, key=lambda seed: ends[seed])
        if ends[first] < max(ends.values()):
            yield (
                f"{group.label} is drawn as far as seed {first} has come: {ends[first]:,.0f} of "
                f"{max(ends.values()):,.0f} steps"
            )


def _unequal_stages(groups: Iterable[Group]) -> Iterator[str]:
    """Tells of seeds that were in different stages at the same step, as with early stopping."""
    for group in groups:
        stages = {run.seed: run.curves["stage"] for run in group.runs if "stage" in run.curves}
        common = min((curve.step[-1] for curve in stages.values()), default=0.0)
        changes = {
            seed: [f"{x:,.0f}" for x in curve.step[1:][np.diff(curve.value) != 0] if x <= common]
            for seed, curve in stages.items()
        }
        if len(set(map(tuple, changes.values()))) > 1:
            told = "; ".join(f"seed {seed}: {', '.join(x)}" for seed, x in changes.items() if x)
            yield f"{group.label} has seeds that changed stages at different steps ({told})"


def _default_panels(groups: Sequence[Group]) -> list[list[str]]:
    """Chooses what tells most of a training, in the order in which one asks."""
    curves: dict[str, list[Curve]] = {}
    components: set[str] = set()
    for run in (run for group in groups for run in group.runs):
        for name, curve in run.curves.items():
            curves.setdefault(name, []).append(curve)
        own = [name.partition("/")[2] for name in run.curves if "/reward/" in name]
        if len(set(own)) > 1:  # a single component is the return once more
            components.update(own)
    outcomes = ["success", "return", *sorted(components)]
    panels = [[f"{EVALUATION}/{name}", f"train/{name}"] for name in outcomes]
    losses = sorted(name for name in curves if name.startswith("losses/"))
    weights = [name for name in losses if name.endswith("/weight")]
    others = [name for name in losses if name not in ("losses/total", *weights)]
    panels += [[name] for name in ("train/teacher_forcing", *weights, "losses/total", *others)]
    panels = [[name for name in panel if name in curves] for panel in panels]
    telling = {name for name, those in curves.items() if extent(c.value for c in those) > 0}
    telling |= set(panels[0])  # success is asked for even if there is nothing else to say of it
    return [panel for panel in panels if telling & set(panel)] or [
        [name] for name in sorted(curves)
    ]


def _having(group: Group, metric: str) -> list[RunCurves]:
    return [run for run in group.runs if metric in run.curves]


def _bands(
    groups: Sequence[Group],
    metric: str,
    statistic: Statistic,
    smooth: float,
    hours: bool,
    notes: list[str],
) -> dict[tuple[int, str], Band]:
    """Returns the bands of a metric by the group's index and its name.

    Groups of which only some seeds have it, or all but never at the same step, are noted.
    """
    bands = {}
    for index, group in enumerate(groups):
        having = _having(group, metric)
        if having and len(having) < len(group.runs):
            seeds = ", ".join(str(run.seed) for run in group.runs if run not in having)
            notes.append(f"{group.label} is without {metric}, which seed {seeds} has not logged")
        elif having:
            curves = [_prepare(run, metric, smooth, hours) for run in having]
            common = band(curves, statistic)
            if common is not None:
                bands[index, metric] = common
                continue
            ends = ", ".join(
                f"seed {run.seed} from {curve.step[0]:g} to {curve.step[-1]:g}"
                for run, curve in zip(having, curves, strict=True)
            )
            notes.append(f"{group.label} logged {metric} at no step with all seeds ({ends})")
    return bands


def _prepare(run: RunCurves, metric: str, smooth: float, hours: bool) -> Curve:
    curve = run.curves[metric]
    if smooth and not metric.startswith(EVALUATION):
        curve = curve.smoothed(smooth)
    return replace(curve, step=run.hours(curve.step)) if hours else curve


def _final(group: Group, metric: str, band: Band) -> Final:
    last = np.flatnonzero(np.isfinite(band.line))[-1]
    low, high = (float(x[last]) if math.isfinite(x[last]) else None for x in (band.low, band.high))
    x, value = float(band.x[last]), float(band.line[last])
    return Final(group.label, metric, len(group.runs), x, value, low, high, band.spread)


if __name__ == "__main__":
    from jaxact.command_line import run_plot

    run_plot()
