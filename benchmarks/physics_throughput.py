"""What jaxact costs round a simulator: `python -m benchmarks.physics_throughput --help`.

Prints JSON lines: the machine; Brax's environments stepped through jaxact and by themselves, with
no turnover and with either side's own; MuJoCo's models stepped through jaxact and by `mjx.step`
alone; with `--train`, PPO by jaxact and by Brax. Each pair is measured in turns in one process. A
line follows it with `ratio`, of the fastest repeats, `ratio_median`, the median of the turns', and
`ratio_processor`, the same of processor seconds, which other programs change the least; all are
above 1 where jaxact is faster.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.env_lines import Line, print_lines
from benchmarks.env_systems import FUSION_EMITTERS_OFF, PHILOX
from benchmarks.env_worker import machine
from jaxact.errors import JaxactError

PROGRAM = "benchmarks.physics_throughput"


@dataclass(frozen=True)
class Arguments:
    """Times worlds of physics beside the simulators they are made of, and prints JSON lines."""

    ids: tuple[str, ...] = ("Brax-reacher-v0", "Brax-hopper-v0", "Physics-Hopper-v0")
    """Worlds of Brax (`Brax-*`) and of MuJoCo's models (`Physics-*`)."""
    lanes: int = 256
    """Worlds side by side."""
    steps: int = 64
    """Steps of every lane in one repeat."""
    repeats: int = 8
    """Repeats; the fastest and the median are reported."""
    train: str | None = None
    """A world of Brax's to train in, too, by jaxact's PPO and by Brax's."""
    updates: int = 8
    """Updates in one repeat of a training."""
    layers: tuple[int, ...] = (64, 64)
    """Sizes of the hidden layers of the trained networks."""
    seed: int = 0
    """Of everything random."""
    output: Path | None = None
    """File for the lines, too."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    flags = os.environ.get("XLA_FLAGS", "")
    # Chains of small matrices are many times slower with them; JAX is imported after this.
    if "xla_cpu_use_fusion_emitters" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {FUSION_EMITTERS_OFF}".strip()
    try:
        print_lines(measure(arguments), arguments.output)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)


def measure(arguments: Arguments) -> Iterator[Line]:
    """Yields the lines.

    Raises:
      JaxactError: a world that is none, or none of these.
    """
    import envs_jax
    from benchmarks.physics_systems import systems_of
    from benchmarks.physics_training import measure_training

    trained = (arguments.train,) if arguments.train else ()
    for name in (*arguments.ids, *trained):
        kinds = ("Brax-",) if name in trained else ("Brax-", "Physics-")
        if not name.startswith(kinds):
            raise JaxactError(f"{name!r} is no world of these: {' or '.join(kinds)}…")
    pomdps = {name: envs_jax.make(name) for name in arguments.ids}
    yield machine()
    for name, pomdp in pomdps.items():
        for turnover, worlds in systems_of(pomdp).items():
            yield from _in_turns(arguments, {"id": name, "turnover": turnover}, worlds)
    for name in trained:
        yield from measure_training(
            name, arguments.lanes, arguments.updates, arguments.repeats, arguments.layers
        )


def _in_turns(arguments: Arguments, head: Line, worlds: dict[str, Any]) -> Iterator[Line]:
    """Yields a line of each system, jaxact's first, and one of the ratio."""
    from benchmarks.jax_loop import compile_loop

    loops = {
        system: compile_loop(world, arguments.seed, PHILOX, arguments.lanes, arguments.steps, 1)
        for system, world in worlds.items()
    }
    seconds: dict[str, list[float]] = {system: [] for system in loops}
    processor: dict[str, list[float]] = {system: [] for system in loops}
    for turn in range(arguments.repeats):
        # Each goes first as often as the other.
        for system in sorted(loops, reverse=bool(turn % 2)):
            begun = time.process_time()
            seconds[system].append(loops[system].run())
            processor[system].append(time.process_time() - begun)
    taken = arguments.lanes * arguments.steps
    best = {system: taken / min(times) for system, times in seconds.items()}
    median = {system: taken / statistics.median(times) for system, times in seconds.items()}
    for system, loop in loops.items():
        tallies = loop.tallies()
        yield {
            **head,
            "system": system,
            "lanes": arguments.lanes,
            "steps_per_second": round(best[system], 1),
            "steps_per_second_median": round(median[system], 1),
            "compile_seconds": round(loop.compile_seconds, 2),
            "steps": arguments.steps,
            "repeats": arguments.repeats,
            "prng": PHILOX,
            "finished": tallies["finished"],
            "checksum": tallies["checksum"],
        }
    ours, peer = loops

    def turn_by_turn(taken: dict[str, list[float]]) -> float:
        """What else the machine does falls on both."""
        pairs = zip(taken[ours], taken[peer], strict=True)
        return round(statistics.median(theirs / own for own, theirs in pairs), 3)

    yield {
        **head,
        "lanes": arguments.lanes,
        "ratio_to": peer,
        "ratio": round(best[ours] / best[peer], 3),
        "ratio_median": turn_by_turn(seconds),
        "ratio_processor": turn_by_turn(processor),
    }


if __name__ == "__main__":
    main()
