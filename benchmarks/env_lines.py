"""The lines of JSON of benchmarks: printed, read back, compared with each other, summed up."""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

Line = dict[str, Any]
# The lines of one world, of jaxact first and then of its peers; by its number of lanes and its id.
Worlds = dict[tuple[int, str], list[Line]]

SLOWEST = 5


def read(path: Path) -> list[Line]:
    """Returns the lines of a file, none if there is none; a line that was cut short is left out."""
    lines = []
    if path.is_file():
        for text in path.read_text(encoding="utf-8").splitlines():
            with suppress(json.JSONDecodeError):
                lines.append(json.loads(text))
    return lines


def print_lines(lines: Iterable[Line], output: Path | None) -> None:
    """Prints each line as soon as it is there, and writes it to a file, too, if there is one."""
    with output.open("w", encoding="utf-8") if output else nullcontext() as file:
        for line in lines:
            for stream in (sys.stdout, file):
                if stream is not None:
                    print(json.dumps(line), file=stream, flush=True)


def by_world(lines: Iterable[Line]) -> Worlds:
    """Returns the lines about worlds, without those that do not say of what system they are."""
    worlds: Worlds = {}
    world: list[Line] = []
    for line in lines:
        if line.get("system") == "jaxact":
            world = worlds[line["lanes"], line["id"]] = []
        if "id" in line and "system" in line:
            world.append(line)
    return worlds


def ratios(lines: list[Line]) -> list[Line]:
    """Returns how many times faster than each peer jaxact is, of lines from one world's run."""
    ours, *peers = lines
    return [
        {
            "id": ours["id"],
            "lanes": ours["lanes"],
            "ratio_to": peer["system"],
            "ratio": round(ours["steps_per_second"] / peer["steps_per_second"], 2),
            "ratio_median": round(
                ours["steps_per_second_median"] / peer["steps_per_second_median"], 2
            ),
        }
        for peer in peers
        if "steps_per_second" in ours and "steps_per_second" in peer
    ]


def summaries(worlds: list[list[Line]]) -> list[Line]:
    """Returns what is to be said of many worlds with one number of lanes.

    The median rate, the slowest worlds, how many times faster than each peer they are (geometric
    means, least and greatest), what took longest to compile, and what failed.

    Args:
      worlds: the lines of each.
    """
    ours = [lines[0] for lines in worlds if "steps_per_second" in lines[0]]
    failed = [lines[0]["id"] for lines in worlds if "steps_per_second" not in lines[0]]
    head = {"lanes": worlds[0][0]["lanes"]}
    found: list[Line] = []
    if ours:
        slowest = sorted(ours, key=lambda line: line["steps_per_second"])[:SLOWEST]
        longest = max(ours, key=lambda line: line["compile_seconds"])
        rates = [line["steps_per_second"] for line in ours]
        found += [
            {"summary": "median", "worlds": len(ours), "steps_per_second": _median(rates)},
            {"summary": "slowest", "steps_per_second": _by_id(slowest, "steps_per_second")},
            {"summary": "compilation", "longest": _by_id([longest], "compile_seconds")},
        ]
    compared = [line for lines in worlds for line in ratios(lines)]
    for peer in dict.fromkeys(line["ratio_to"] for line in compared):
        lines = sorted(
            (line for line in compared if line["ratio_to"] == peer), key=lambda line: line["ratio"]
        )
        mean = statistics.geometric_mean(line["ratio"] for line in lines)
        found.append(
            {
                "summary": "ratio",
                "ratio_to": peer,
                "worlds": len(lines),
                "geometric_mean": round(mean, 2),
                "least": _by_id(lines[:1], "ratio"),
                "greatest": _by_id(lines[-1:], "ratio"),
            }
        )
    if failed:
        found.append({"summary": "failed", "ids": failed})
    return [head | line for line in found]


def _median(numbers: list[float]) -> float:
    return round(statistics.median(numbers), 1)


def _by_id(lines: list[Line], name: str) -> dict[str, float]:
    return {line["id"]: line[name] for line in lines}
