"""ADVISOR's methods with the very numbers of published draws: `python -m benchmarks.advisor_pairs`.

Random searches differ by what they happen to draw. Here each method is trained in the crossings of
lava with the learning rates and the other numbers of ten of the published draws, and each draw's
return is set beside the published one. The draws are those of learning rates between 2e-4 and 1e-2,
outside of which hardly any of the published ones learnt, sorted by it and ten of them taken at
equal distances. `docs/results/advisor_pairs.json` has the draws, their mean difference, and
Student's 95 % interval of that over the draws.

Published are the runs of L. Weihs et al., "Bridging the imitation gap by adaptive insubordination",
NeurIPS 2021, with the seeds that these had; ours have seed 0.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from benchmarks.advisor_study import METRIC, newest_sweep, this_commit
from benchmarks.results import RESULTS
from jaxact.errors import JaxactError, unknown

WORLD = "lava_crossing"
LEARNING_RATES = (
    2.0633647e-4,
    2.4089617e-4,
    3.4901624e-4,
    4.8861966e-4,
    1.08981784e-3,
    1.31316445e-3,
    1.89766158e-3,
    3.48780252e-3,
    3.61130753e-3,
    9.84162781e-3,
)
# What each method draws besides: ADVISOR's α, and the share of the steps that a warm start takes.
ALPHAS = (8.0, 16.0, 4.0, 4.0, 4.0, 32.0, 8.0, 16.0, 32.0, 32.0)
WARM_STARTS = (
    0.28080960,
    0.55371530,
    0.43629424,
    0.26371891,
    0.81161605,
    0.44825791,
    0.59541677,
    0.44879592,
    0.26139458,
    0.31346182,
)
PUBLISHED = {
    "advisor": (0.040, 0.166, 0.483, 0.499, 0.615, 0.317, 0.766, 0.853, 0.496, 0.658),
    "dagger_to_ppo": (0.075, 0.573, 0.769, 0.294, 0.271, 0.001, 0.220, 0.161, 0.505, 0.000),
    "bc_forced_to_ppo": (0.022, 0.246, 0.187, 0.107, 0.402, 0.038, 0.466, 0.847, 0.006, 0.035),
}


@dataclass(frozen=True)
class Arguments:
    """Trains methods with published draws' numbers and adds what came of it to the results."""

    methods: tuple[str, ...] = ()
    """Of `examples/advisor.py`; by default those that the results lack."""
    chunk: int | None = None
    """See `benchmarks.advisor_study`."""
    sweeps: Path = Path("sweeps/pairs")
    """Directory for the sweeps; the newest of each method is gone on with."""
    output: Path = RESULTS
    """Directory for the results."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog="python -m benchmarks.advisor_pairs")
    try:
        pair(arguments)
    except JaxactError as error:
        print(f"benchmarks.advisor_pairs: {error}", file=sys.stderr)
        sys.exit(2)


def pair(arguments: Arguments) -> None:
    """Trains one method after the other, and writes after each.

    Raises:
      JaxactError: there is no such method.
    """
    import jaxact
    from examples.advisor import experiments, search_space
    from jaxact.search_space import SearchSpace, in_order

    path = arguments.output / "advisor_pairs.json"
    done = dict(json.loads(path.read_text())["methods"]) if path.exists() else {}
    for method in arguments.methods:
        if method not in PUBLISHED:
            raise unknown("method", method, PUBLISHED)
    for method in arguments.methods or [m for m in PUBLISHED if m not in done]:
        experiment = experiments[f"{WORLD}_{method}"]
        steps = experiment.pipeline.total_steps
        values = (
            LEARNING_RATES,
            ALPHAS if method == "advisor" else [share * steps for share in WARM_STARTS],
        )
        paths = search_space(f"{WORLD}_{method}")
        space = {key: in_order(*x) for key, x in zip(paths, values, strict=True)}
        found = jaxact.sweep(
            experiment,
            space,
            draws=len(LEARNING_RATES),
            chunk=arguments.chunk,
            output=arguments.sweeps,
            resume=newest_sweep(arguments.sweeps / experiment.name),
        )
        done[method] = {
            "experiment": f"examples/advisor.py:{WORLD}_{method}",
            "space": SearchSpace.of(space).to_texts(),
            "commit": this_commit(),
            **compare(found.records, PUBLISHED[method]),
            "records": found.records,
        }
        _write(done, path)


def compare(records: list[Any], published: tuple[float, ...]) -> dict[str, Any]:
    """Returns the returns of draws, those published, and the mean difference with its interval.

    Args:
      records: of the draws, in order.
      published: the last returns of the same draws.
    """
    from jaxact.statistics import mean_interval
    from jaxact.sweep_report import draw_scores

    ours = draw_scores(records, METRIC)
    difference = ours - np.array(published)
    return {
        "ours": ours.tolist(),
        "published": list(published),
        "difference": {"mean": difference.mean(), "interval": mean_interval(difference)},
    }


def _write(methods: Mapping[str, Any], path: Path) -> None:
    from jaxact.runs import versions

    for method, found in methods.items():
        ours, there = (sum(found[x]) / len(found[x]) for x in ("ours", "published"))
        low, high = found["difference"]["interval"]
        print(
            f"{method:18} mean {ours:.3f}, published {there:.3f}; difference "
            f"{found['difference']['mean']:+.3f} [{low:+.3f}, {high:+.3f}]; best "
            f"{max(found['ours']):.3f}, published {max(found['published']):.3f}"
        )
    result = {
        "name": "advisor_pairs",
        "command": "python -m benchmarks.advisor_pairs",
        "metric": f"{METRIC} at the last evaluation",
        "versions": versions(),
        "methods": methods,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
