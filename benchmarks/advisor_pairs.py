"""ADVISOR's methods with the very numbers of published draws: `python -m benchmarks.advisor_pairs`.

Random searches differ by what they happen to draw. Here each method is trained in the crossings of
lava with the learning rates and the other numbers of the published draws, and each draw's return is
set beside the published one. The draws are all of those of learning rates between 2e-4 and 1e-2,
outside of which hardly any of the published ones learnt. `docs/results/advisor_pairs.json` has the
draws, their mean difference with Student's 95 % interval over the draws, the mean best of ten of
them, and that of ten of all 50 published draws if the others come to nothing; and how far ADVISOR
is ahead of each other method at the same learning rates, here and as published. Draws that it has
are not trained again.

Published are the runs of L. Weihs et al., "Bridging the imitation gap by adaptive insubordination",
NeurIPS 2021, with the seeds that these had; ours have seed 0.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro

from benchmarks.advisor_study import BEST_OF, METRIC, newest_sweep, this_commit
from benchmarks.results import RESULTS
from jaxact.errors import JaxactError, unknown

WORLD = "lava_crossing"
RATE = "pipeline.learning_rate.start"


class Draw(NamedTuple):
    """A published draw.

    Attributes:
      learning_rate: at the start.
      alpha: ADVISOR's.
      warm_start: the share of the steps that imitation takes, of methods that begin with it.
      advisor, dagger_to_ppo, bc_forced_to_ppo: the last return of each method.
    """

    learning_rate: float
    alpha: float
    warm_start: float
    advisor: float
    dagger_to_ppo: float
    bc_forced_to_ppo: float


DRAWS = (
    Draw(0.00020633647, 8.0, 0.28080960, 0.040, 0.075, 0.022),
    Draw(0.00021956226, 4.0, 0.36426786, 0.295, 0.172, 0.820),
    Draw(0.00023109044, 16.0, 0.47422999, 0.056, 0.360, 0.577),
    Draw(0.00024089617, 16.0, 0.55371530, 0.166, 0.573, 0.246),
    Draw(0.00030267168, 32.0, 0.86299378, 0.267, 0.181, 0.150),
    Draw(0.00033058799, 4.0, 0.77724919, 0.488, 0.074, 0.039),
    Draw(0.00034901624, 4.0, 0.43629424, 0.483, 0.769, 0.187),
    Draw(0.00042481283, 16.0, 0.27624497, 0.697, 0.240, 0.000),
    Draw(0.00048861966, 4.0, 0.26371891, 0.499, 0.294, 0.107),
    Draw(0.00054046984, 4.0, 0.16371638, 0.441, 0.067, 0.511),
    Draw(0.00057050931, 8.0, 0.20766396, 0.513, 0.000, 0.847),
    Draw(0.00108981784, 4.0, 0.81161605, 0.615, 0.271, 0.402),
    Draw(0.0011600383, 8.0, 0.52848334, 0.856, 0.055, 0.765),
    Draw(0.0012191859, 32.0, 0.72124735, 0.772, 0.653, 0.683),
    Draw(0.00131316445, 32.0, 0.44825791, 0.317, 0.001, 0.038),
    Draw(0.0014432668, 32.0, 0.44249786, 0.727, 0.762, 0.391),
    Draw(0.0014692065, 16.0, 0.40951412, 0.761, 0.018, 0.257),
    Draw(0.00189766158, 8.0, 0.59541677, 0.766, 0.220, 0.466),
    Draw(0.0029351546, 8.0, 0.33972374, 0.572, 0.555, 0.903),
    Draw(0.00348780252, 16.0, 0.44879592, 0.853, 0.161, 0.847),
    Draw(0.0034962135, 32.0, 0.78318023, 0.887, 0.002, 0.444),
    Draw(0.0035529405, 16.0, 0.59690707, 0.483, 0.734, 0.189),
    Draw(0.00361130753, 32.0, 0.26139458, 0.496, 0.505, 0.006),
    Draw(0.0045367486, 32.0, 0.44203677, 0.790, 0.015, 0.024),
    Draw(0.0093791266, 8.0, 0.48645587, 0.716, 0.037, 0.188),
    Draw(0.00984162781, 32.0, 0.31346182, 0.658, 0.000, 0.035),
)
# Draws of each method in the published search.
SEARCHED = 50
METHODS = ("advisor", "dagger_to_ppo", "bc_forced_to_ppo")


@dataclass(frozen=True)
class Arguments:
    """Trains methods with published draws' numbers and adds what came of it to the results."""

    methods: tuple[str, ...] = ()
    """Of `examples/advisor.py`; by default all three."""
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
    """Trains one method after the other, writes after each, and prints what came of all.

    Raises:
      JaxactError: there is no such method.
    """
    path = arguments.output / "advisor_pairs.json"
    done = dict(json.loads(path.read_text())["methods"]) if path.exists() else {}
    for method in arguments.methods:
        if method not in METHODS:
            raise unknown("method", method, METHODS)
    for method in arguments.methods or METHODS:
        records = list(done.get(method, {}).get("records", []))
        missing = [draw for draw in DRAWS if not any(_is_of(draw, x) for x in records)]
        if missing:
            records += _train(method, missing, arguments)
        records = [
            next(x for x in records if _is_of(draw, x)) | {"draw": i}
            for i, draw in enumerate(DRAWS)
        ]
        done[method] = {
            "experiment": f"examples/advisor.py:{WORLD}_{method}",
            **compare(records, [getattr(draw, method) for draw in DRAWS]),
            "records": records,
        }
        _write(done, path)
    _print(done)


def _is_of(draw: Draw, record: Mapping[str, Any]) -> bool:
    # No two draws have a learning rate in common.
    return math.isclose(record["numbers"][RATE], draw.learning_rate, rel_tol=1e-6)


def _train(method: str, draws: Sequence[Draw], arguments: Arguments) -> list[dict[str, Any]]:
    import jaxact
    from examples.advisor import experiments, search_space
    from jaxact.search_space import in_order

    experiment = experiments[f"{WORLD}_{method}"]
    steps = experiment.pipeline.total_steps
    paths = search_space(f"{WORLD}_{method}")
    others = [draw.alpha if method == "advisor" else draw.warm_start * steps for draw in draws]
    values = ([draw.learning_rate for draw in draws], others)
    found = jaxact.sweep(
        experiment,
        {key: in_order(*x) for key, x in zip(paths, values, strict=True)},
        draws=len(draws),
        chunk=arguments.chunk,
        output=arguments.sweeps,
        resume=newest_sweep(arguments.sweeps / experiment.name),
    )
    return [record | {"commit": this_commit()} for record in found.records]


def compare(records: Sequence[dict[str, Any]], published: Sequence[float]) -> dict[str, Any]:
    """Returns the returns of draws, those published, their difference, and the best of ten of each,
    out of these draws and out of all 50 with 0 for the others.

    Args:
      records: of the draws, in order.
      published: the last returns of the same draws.
    """
    from jaxact.statistics import expected_best
    from jaxact.sweep_report import draw_scores

    sides = {"ours": draw_scores(records, METRIC), "published": np.array(published)}
    difference = sides["ours"] - sides["published"]
    best = min(BEST_OF, len(published))
    nothing = np.zeros(SEARCHED - len(published))
    return {
        **{side: values.tolist() for side, values in sides.items()},
        "difference": _mean(difference),
        "best_of_10": {side: expected_best(x, best) for side, x in sides.items()},
        "best_of_10_of_50": {
            side: expected_best(np.append(x, nothing), BEST_OF) for side, x in sides.items()
        },
    }


def advisor_ahead(methods: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns by how much ADVISOR's returns are above those of each other method, draw by draw.

    Args:
      methods: what `compare` found for each, of the same draws.
    """
    return {
        method: {
            side: _mean(np.subtract(methods["advisor"][side], found[side]))
            for side in ("ours", "published")
        }
        for method, found in methods.items()
        if method != "advisor" and "advisor" in methods
    }


def _mean(values: np.ndarray) -> dict[str, Any]:
    from jaxact.statistics import mean_interval

    return {"mean": values.mean(), "interval": mean_interval(values)}


def _write(methods: Mapping[str, Any], path: Path) -> None:
    from jaxact.runs import versions

    result = {
        "name": "advisor_pairs",
        "command": "python -m benchmarks.advisor_pairs",
        "metric": f"{METRIC} at the last evaluation",
        "versions": versions(),
        "advisor_ahead": advisor_ahead(methods),
        "methods": methods,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")


def _print(methods: Mapping[str, Any]) -> None:
    for method, found in methods.items():
        ours, there = (sum(found[x]) / len(found[x]) for x in ("ours", "published"))
        best, of_all = found["best_of_10"], found["best_of_10_of_50"]
        print(
            f"{method:18} {len(found['ours'])} draws: mean {ours:.3f}, published {there:.3f}; "
            f"difference {_text(found['difference'])}; best of {BEST_OF} {best['ours']:.3f}, "
            f"published {best['published']:.3f}; of {SEARCHED} {of_all['ours']:.3f}, published "
            f"{of_all['published']:.3f}"
        )
    for method, ahead in advisor_ahead(methods).items():
        print(f"advisor - {method}: {_text(ahead['ours'])}, published {_text(ahead['published'])}")


def _text(mean: Mapping[str, Any]) -> str:
    low, high = mean["interval"]
    return f"{mean['mean']:+.3f} [{low:+.3f}, {high:+.3f}]"


if __name__ == "__main__":
    main()
