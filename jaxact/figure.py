"""The figure of learning curves: panels, colours, legend and caption."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxact.curves import EVALUATION
from jaxact.groups import Band, Group, Statistic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Horizontal = Literal["steps", "hours"]

# Okabe and Ito's palette, told apart by the colour-blind, without its yellow, which is hard to see
# on white. Source: M. Okabe and K. Ito, "Color universal design" (2008).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_DASHES = ("-", "--", ":", "-.")  # of the second seven groups, and so on
_GREY = "#555555"
_RATES = ("success", "teacher_forcing")
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _GREY,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "xtick.color": _GREY,
    "ytick.color": _GREY,
    "xtick.labelcolor": "black",
    "ytick.labelcolor": "black",
    # Names of parts would else be random, and the same curves another file every time.
    "svg.hashsalt": "jaxact",
}


def draw(
    groups: Sequence[Group],
    panels: Sequence[Sequence[str]],
    bands: dict[tuple[int, str], Band],
    x: Horizontal,
    statistic: Statistic,
    smooth: float,
) -> Figure:
    """Draws a panel for each list of metrics."""
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    columns = min(len(panels), 4 if len(panels) > 6 else 3)
    rows = -(-len(panels) // columns)
    width, height = (7.2, 3.6) if len(panels) == 1 else (3.1 * columns, 2.3 * rows)
    labels = [_legend_text(group) for group in groups]
    abreast = max(1, min(len(groups), int(width / (0.07 * max(map(len, labels)) + 0.5))))
    height += 0.5 + 0.2 * -(-len(groups) // abreast)
    with mpl.rc_context(STYLE):
        figure = Figure((width, height), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for axes, panel in zip(grid.flat, panels, strict=False):
            for position, name in enumerate(panel):
                for index in (index for index in range(len(groups)) if (index, name) in bands):
                    style = _style(index) | ({} if name.startswith(EVALUATION) else {"marker": ""})
                    _draw_band(axes, bands[index, name], style, thin=position > 0)
            _dress(axes, panel, [bands[key] for key in bands if key[1] in panel], x)
        for axes in grid[-1]:
            axes.set_xlabel("environment steps" if x == "steps" else "hours")
        for axes in grid.flat[len(panels) :]:
            axes.remove()
        handles = [Line2D([], [], label=text, **_style(i)) for i, text in enumerate(labels)]
        figure.legend(handles=handles, loc="outside upper left", ncols=abreast, frameon=False)
        caption = fill(_caption(panels, bands, statistic, smooth), int(width * 16))
        if caption:
            figure.supxlabel(caption, x=0.01, ha="left", fontsize=8, color=_GREY)
    return figure


def _legend_text(group: Group) -> str:
    return group.label + (f" ({len(group.runs)} seeds)" if len(group.runs) > 1 else "")


def _style(group: int) -> dict[str, Any]:
    return {
        "color": _COLOURS[group % len(_COLOURS)],
        "linestyle": _DASHES[group // len(_COLOURS) % len(_DASHES)],
        "marker": _MARKERS[group % len(_MARKERS)],
        "markersize": 4,
    }


def _draw_band(axes: Axes, band: Band, style: dict[str, Any], *, thin: bool) -> None:
    width, alpha = (0.8, 0.5) if thin else (1.4, 1.0)
    axes.plot(band.x, band.line, **style, linewidth=width, alpha=alpha, zorder=2.5 - thin)
    if not thin:
        shade = {"color": style["color"], "alpha": 0.18, "linewidth": 0}
        axes.fill_between(band.x, band.low, band.high, **shade)


def _dress(axes: Axes, panel: Sequence[str], bands: Sequence[Band], x: str) -> None:
    """Gives a panel its title, limits and ticks."""
    axes.set_title(_title(panel))
    axes.tick_params(labelbottom=True)
    if all(name.endswith(_RATES) for name in panel):
        axes.set_ylim(-0.02, 1.02)
    else:
        # Intervals of two or three seeds may be many times as wide as what they are of is high.
        lines = np.concatenate([band.line for band in bands])
        ends = np.concatenate([part for band in bands for part in (band.line, band.low, band.high)])
        reach = extent([lines])
        low = max(np.nanmin(lines) - reach, np.nanmin(ends))
        high = min(np.nanmax(lines) + reach, np.nanmax(ends))
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        axes.set_ylim(low - margin, high + margin)
    axes.locator_params(axis="y", nbins=5)
    axes.locator_params(axis="x", nbins=5)
    # Else a common power of ten stands above the axis, where it pushes the title up.
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    if x == "steps":
        axes.xaxis.set_major_formatter(lambda value, _: steps_text(value))


def _title(panel: Sequence[str]) -> str:
    """Names the metrics; what they are of only once, if it is the same."""
    whole = [(name, *name.partition("/")) for name in panel]
    subjects = {subject for _, _, _, subject in whole}
    same = len(panel) > 1 and len(subjects) == 1
    first, *others = [prefix if same else name for name, prefix, _, _ in whole]
    text = f"{first}; thin: {', '.join(others)}" if others else first
    return f"{subjects.pop()} ({text})" if same else text


def steps_text(steps: float) -> str:
    """Writes a number of steps with thousands as k and millions as M.

    >>> [steps_text(x) for x in (0, 250, 2_500, 500_000, 1_250_000)]
    ['0', '250', '2.5k', '500k', '1.25M']
    """
    for size, unit in ((1e6, "M"), (1e3, "k")):
        if abs(steps) >= size:
            return f"{steps / size:g}{unit}"
    return f"{steps:g}"


def _caption(
    panels: Iterable[Sequence[str]],
    bands: dict[tuple[int, str], Band],
    statistic: Statistic,
    smooth: float,
) -> str:
    """Says what bands and markers are."""
    spreads = {one.spread for one in bands.values()}
    of_seeds = {
        "median": "Lines are medians over seeds, bands the quartiles",
        "mean": "Lines are means over seeds, bands 95 % intervals (Student's)",
    }
    parts = []
    if "seeds" in spreads:
        parts.append(of_seeds[statistic])
    if any(name.startswith(EVALUATION) for panel in panels for name in panel):
        parts.append("Markers: held-out episodes")
        if "episodes" in spreads:
            parts[-1] += ", of a single seed with 95 % intervals over episodes"
    if smooth:
        parts.append(f"Averaged over {steps_text(smooth)} steps")
    return "".join(f"{part}. " for part in parts).strip()


def extent(values: Iterable[np.ndarray]) -> float:
    """Returns the difference between the largest and the smallest value that are known."""
    joined = np.concatenate(list(values))
    known = joined[np.isfinite(joined)]
    return float(known.max() - known.min()) if len(known) else 0.0
