"""Turns the lines of `benchmarks.env_throughput` into `docs/results/<name>.json` and a figure.

Run `python -m benchmarks.env_results LINES --commit COMMIT`. The figure shows the rate of every
world, the fastest first, beside those of the peers that were measured with it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from benchmarks.env_lines import Line, by_world, read
from benchmarks.results import RESULTS


@dataclass(frozen=True)
class Arguments:
    """Writes results and a figure."""

    lines: tyro.conf.Positional[Path]
    """What `benchmarks.env_throughput --output` wrote."""
    commit: str
    """The commit that was measured."""
    command: str
    """The command that measured it."""
    name: str = "env_throughput_all"
    """Name of the file and the figure."""
    output: Path = RESULTS
    """Directory to write to."""


def main() -> None:
    """Parses the command line and writes the files."""
    arguments = tyro.cli(Arguments)
    lines = read(arguments.lines)
    arguments.output.mkdir(parents=True, exist_ok=True)
    result = {"name": arguments.name, "command": arguments.command, "commit": arguments.commit}
    path = arguments.output / f"{arguments.name}.json"
    path.write_text(json.dumps(result | {"lines": lines}, indent=1) + "\n", encoding="utf-8")
    draw(lines, arguments.output / f"{arguments.name}.png")


def draw(lines: list[Line], path: Path) -> None:
    """Draws the rates of all worlds, one series for each system."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    worlds = [world for world in by_world(lines).values() if "steps_per_second" in world[0]]
    worlds.sort(key=lambda world: -world[0]["steps_per_second"])
    series: dict[str, list[tuple[int, float]]] = {}
    for place, world in enumerate(worlds, 1):
        for line in world:
            if "steps_per_second" in line:
                points = series.setdefault(line["system"], [])
                points.append((place, line["steps_per_second"]))
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    for system, points in series.items():
        axes.plot(*zip(*points, strict=True), "o", markersize=3, label=system)
    axes.set(xlabel="worlds, fastest first", ylabel="steps a second", yscale="log")
    axes.set_title(f"{len(worlds)} worlds, {worlds[0][0]['lanes']:,} lanes, random actions")
    axes.legend()
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
