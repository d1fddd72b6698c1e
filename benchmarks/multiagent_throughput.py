"""How fast worlds of several agents step: `python -m benchmarks.multiagent_throughput --help`.

As `benchmarks.env_throughput`, beside worlds of like size of JaxMARL's, each with its own automatic
reset. A step is one of a world, in which all of its agents act; the worlds are not the same ones,
so that a ratio says no more than how much a step of either costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import envs_jax
from benchmarks import env_throughput
from benchmarks.env_systems import PEERS_OF_AGENTS

PROGRAM = "benchmarks.multiagent_throughput"


@dataclass(frozen=True)
class Arguments(env_throughput.Arguments):
    """Times worlds of several agents under random actions, and prints lines of JSON."""

    known_peers: ClassVar[tuple[str, ...]] = tuple(PEERS_OF_AGENTS)

    ids: tuple[str, ...] = tuple(
        name for name in envs_jax.ids() if name.startswith(("Markov-", "MultiGrid-", "Furn"))
    )
    """Worlds, by their ids."""
    peers: tuple[str, ...] = tuple(PEERS_OF_AGENTS)
    """Systems to measure beside jaxact: jaxmarl-coin, jaxmarl-storm, jaxmarl-overcooked, which
    need the package jaxmarl; `--peers` without a name measures jaxact alone."""


def main() -> None:
    """Runs the command line."""
    env_throughput.run(Arguments, PROGRAM)


if __name__ == "__main__":
    main()
