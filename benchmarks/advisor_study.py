"""ADVISOR's comparison of nine methods by random search.

Run `python -m benchmarks.advisor_study WORLD`. Each method of `examples/advisor.py` is searched by
a sweep of its own. As soon as one has ended, its draws and what can be expected of the best of ten
go into `docs/results/advisor_<world>.json` beside the published figure, and `.png` and `.svg` of
all methods so far are drawn anew; so the study can be made a few methods at a time.
`advisor_demonstrations` needs recorded ones, see there.

Published are the rewards of L. Weihs et al., "Bridging the imitation gap by adaptive
insubordination", NeurIPS 2021 (expected best of 10 of 50 draws).
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from benchmarks.results import RESULTS
from jaxact.errors import JaxactError, unknown

PUBLISHED = {
    "lava_crossing": {
        "ppo": 0.00,
        "bc": 0.02,
        "dagger": 0.02,
        "bc_forced": 0.02,
        "bc_to_ppo": 0.32,
        "dagger_to_ppo": 0.61,
        "bc_forced_to_ppo": 0.74,
        "advisor": 0.80,
        "advisor_demonstrations": 0.94,
    },
    "poisoned_doors": {
        "ppo": 0.00,
        "bc": -0.60,
        "dagger": -0.59,
        "bc_forced": -0.62,
        "bc_to_ppo": -0.17,
        "dagger_to_ppo": -0.45,
        "bc_forced_to_ppo": -0.50,
        "advisor": 1.00,
        "advisor_demonstrations": 0.00,
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
    """Of each method; at least ten."""
    sweeps: Path = Path("sweeps")
    """Directory for the sweeps."""
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
            experiments[name], space, draws=arguments.draws, output=arguments.sweeps
        )
        methods = _read(path) | {
            method: {
                "experiment": f"examples/advisor.py:{name}",
                "space": SearchSpace.of(space).to_texts(),
                "commit": _commit(),
                "records": found.records,
            }
        }
        _write(arguments.world, {m: methods[m] for m in published if m in methods}, path)


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
        found["published_best_of_10"] = PUBLISHED[world][method]
        beside = f"[{low:.3f}, {high:.3f}], published {PUBLISHED[world][method]:.2f}"
        print(f"{method:24} {expected:6.3f} {beside}")
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


def _commit() -> str:
    command = ("git", "rev-parse", "--short", "HEAD")
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
