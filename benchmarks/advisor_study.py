"""ADVISOR's comparison of nine methods by random search.

Run `python -m benchmarks.advisor_study WORLD`. Each method of `examples/advisor.py` is searched by
a sweep of its own. As soon as one has ended, its draws and what can be expected of the best of ten
go into `docs/results/advisor_<world>.json` beside the published figure, and `.png` and `.svg` of
all methods so far are drawn anew; so the study can be made a few methods at a time.
`advisor_demonstrations` needs recorded ones, see there.

Published are the rewards of L. Weihs et al., "Bridging the imitation gap by adaptive
insubordination", NeurIPS 2021: the mean best of 10 of 50 draws, as the paper has it, and from the
draws themselves how widely the best of ten varies.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import tyro

from benchmarks.results import RESULTS
from jaxact.errors import JaxactError, unknown


class Published(NamedTuple):
    """The best of ten of the 50 draws that were published.

    Attributes:
      mean: over all ways of choosing ten.
      low: their 2.5th percentile; where a method seldom works, one search says little.
      high: their 97.5th percentile.
    """

    mean: float
    low: float
    high: float


PUBLISHED = {
    "lava_crossing": {
        "ppo": Published(0.000, 0.000, 0.001),
        "bc": Published(0.018, 0.008, 0.030),
        "dagger": Published(0.015, 0.008, 0.020),
        "bc_forced": Published(0.017, 0.011, 0.020),
        "bc_to_ppo": Published(0.319, 0.033, 0.616),
        "dagger_to_ppo": Published(0.609, 0.172, 0.769),
        "bc_forced_to_ppo": Published(0.738, 0.246, 0.903),
        "advisor": Published(0.797, 0.513, 0.887),
        "advisor_demonstrations": Published(0.942, 0.853, 0.958),
    },
    "poisoned_doors": {
        "ppo": Published(0.000, 0.000, 0.002),
        "bc": Published(-0.598, -0.640, -0.562),
        "dagger": Published(-0.589, -0.640, -0.548),
        "bc_forced": Published(-0.620, -0.640, -0.592),
        "bc_to_ppo": Published(-0.170, -0.584, 0.000),
        "dagger_to_ppo": Published(-0.449, -0.612, -0.032),
        "bc_forced_to_ppo": Published(-0.501, -0.644, -0.090),
        "advisor": Published(1.000, 0.999, 1.000),
        "advisor_demonstrations": Published(0.002, 0.000, 0.006),
    },
}
METRIC = "return"
BEST_OF = 10


@dataclass(frozen=True)
class Arguments:
    """Searches methods and adds what was found to the study's results."""

    world: tyro.conf.Positional[Literal["lava_crossing", "poisoned_doors"]]
    """Which of ADVISOR's worlds."""
    methods: tuple[str, ...] = ()
    """Of `examples/advisor.py`; by default those that the results lack."""
    draws: int = BEST_OF
    """Of each method; at least ten. Those that a sweep in `sweeps` has are not trained again."""
    chunk: int | None = None
    """Draws trained side by side; by default as many as fit in memory. On a CPU a draw for each
    core is the fastest here: weights stay in its cache."""
    sweeps: Path = Path("sweeps")
    """Directory for the sweeps; the newest of each method is gone on with. One of another
    experiment, or of other ranges, is refused: choose another directory to begin anew."""
    output: Path = RESULTS
    """Directory for the results and the figure."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog="python -m benchmarks.advisor_study")
    try:
        study(arguments)
    except JaxactError as error:
        print(f"benchmarks.advisor_study: {error}", file=sys.stderr)
        sys.exit(2)


def study(arguments: Arguments) -> None:
    """Searches one method after the other, and writes after each.

    Raises:
      JaxactError: there is no such method, or there are too few draws.
    """
    import jaxact
    from examples.advisor import experiments, search_space
    from jaxact.search_space import SearchSpace

    if arguments.draws < BEST_OF:
        raise JaxactError(f"the best of {BEST_OF} needs as many draws; got {arguments.draws}")
    published = PUBLISHED[arguments.world]
    for method in arguments.methods:
        if method not in published:
            raise unknown("method", method, published)
    path = arguments.output / f"advisor_{arguments.world}.json"
    for method in arguments.methods or [m for m in published if m not in _read(path)]:
        name = f"{arguments.world}_{method}"
        space = search_space(name)
        found = jaxact.sweep(
            experiments[name],
            space,
            draws=arguments.draws,
            chunk=arguments.chunk,
            output=arguments.sweeps,
            resume=newest_sweep(arguments.sweeps / experiments[name].name),
        )
        methods = _read(path) | {
            method: {
                "experiment": f"examples/advisor.py:{name}",
                "space": SearchSpace.of(space).to_texts(),
                "commit": this_commit(),
                "records": found.records,
            }
        }
        _write(arguments.world, {m: methods[m] for m in published if m in methods}, path)


def newest_sweep(sweeps: Path) -> Path | None:
    """Returns the last begun of an experiment's sweeps: directories are named by time of day."""
    return max(sweeps.iterdir(), default=None) if sweeps.is_dir() else None


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text())["methods"]) if path.exists() else {}


def _write(world: str, methods: dict[str, Any], path: Path) -> None:
    from jaxact.runs import versions
    from jaxact.sweep_report import draw_curves, draw_scores, expected_best_curve

    curves = []
    for method, found in methods.items():
        curve = expected_best_curve(method, draw_scores(found["records"], METRIC))
        curves.append(curve)
        expected, low, high = curve.points[BEST_OF]
        found["best_of_10"] = {"mean": expected, "interval": [low, high]}
        there = PUBLISHED[world][method]
        found["published_best_of_10"] = {"mean": there.mean, "range": [there.low, there.high]}
        beside = f"published {there.mean:6.3f}, 95 % of them {there.low:.3f} to {there.high:.3f}"
        print(f"{method:24} {expected:6.3f} [{low:.3f}, {high:.3f}]; {beside}")
    result = {
        "name": f"advisor_{world}",
        "command": f"python -m benchmarks.advisor_study {world}",
        "metric": f"{METRIC} at the last evaluation",
        "versions": versions(),
        "methods": methods,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")
    print(path, *draw_curves(curves, METRIC, False, path.with_suffix("")))


def this_commit() -> str:
    command = ("git", "rev-parse", "--short", "HEAD")
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
