"""How often experts succeed within the horizon: `python -m benchmarks.expert_success --help`.

The expert is followed from fresh levels to the end of each episode, or until its advice is not
valid. Prints a line of JSON for each world.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import envs_jax
from benchmarks.env_lines import Line, print_lines, read
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, State

DEFAULT_IDS = (
    "BabyAI-GoToLocal-v0",
    "BabyAI-SynthS5R2-v0",
    "BabyAI-BossLevel-v0",
    "MiniGrid-DoorKey-8x8-v0",
    "MiniGrid-ObstructedMaze-Full-v1",
)
PROGRAM = "benchmarks.expert_success"


@dataclass(frozen=True)
class Arguments:
    """Follows experts to the end of episodes and prints lines of JSON."""

    ids: tuple[str, ...] = DEFAULT_IDS
    """Worlds, by Farama's ids."""
    all: bool = False
    """Every world that has an expert, instead of --ids."""
    episodes: int = 1000
    """Episodes of each world, all side by side."""
    seed: int = 0
    """Of everything random."""
    output: Path | None = None
    """File for the lines, too, each as soon as it is there. Worlds that are in it already with as
    many episodes and this seed, from a run that was stopped, are not played again."""


class Record(NamedTuple):
    """How episodes went, an entry each: whether with success, after how many steps, and whether the
    expert abstained, which ends them here."""

    won: np.ndarray
    steps: np.ndarray
    abstained: np.ndarray


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        ids = check(arguments)
        before = read(arguments.output) if arguments.output else []
        print_lines(measure(arguments, ids, before), arguments.output)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)


def check(arguments: Arguments) -> list[str]:
    """Returns the ids to play.

    Raises:
      JaxactError: an id, a world without expert, or a number that cannot be.
    """
    if arguments.episodes < 1:
        raise JaxactError(f"--episodes must be at least 1; got {arguments.episodes}")
    if arguments.all:
        return [name for name in envs_jax.ids() if envs_jax.make(name).has_expert]
    for name in arguments.ids:
        if not envs_jax.make(name).has_expert:
            raise JaxactError(f"{name!r} has no expert")
    return list(arguments.ids)


def measure(arguments: Arguments, ids: list[str], before: list[Line]) -> Iterator[Line]:
    """Yields the line of each world, those of a run before that was stopped first."""
    wanted = (arguments.episodes, arguments.seed)
    done = {
        line["id"]: line
        for line in before
        if line.get("id") in ids and (line.get("episodes"), line.get("seed")) == wanted
    }
    yield from done.values()
    for name in ids:
        if name not in done:
            yield play(name, *wanted)


def play(name: str, episodes: int, seed: int) -> Line:
    """Plays so many episodes of a world and returns its line.

    Returns:
      The shares of episodes that ended with success, with advice that was not valid ("abstained"),
      and otherwise ("lost"); the mean length of those with success, None if there are none; and the
      seconds that all of it took, compilation included.
    """
    began = time.perf_counter()
    pomdp = replace(envs_jax.make(name), sensors={})
    keys = jax.random.split(jax.random.key(seed), episodes)
    record = follow(pomdp, keys, jax.jit(jax.vmap(lambda key: pomdp.reset(key)[0]))(keys))
    won, abstained = record.won, record.abstained
    return {
        "id": name,
        "episodes": episodes,
        "seed": seed,
        "success": float(np.mean(won)),
        "abstained": float(np.mean(abstained)),
        "lost": float(np.mean(~won & ~abstained)),
        "mean_length": round(float(np.mean(record.steps[won])), 2) if np.any(won) else None,
        "seconds": round(time.perf_counter() - began, 1),
    }


def follow(pomdp: POMDP, keys: jax.Array, state: State) -> Record:
    """Follows the expert to the end of each episode.

    Args:
      pomdp: the world, best without sensors.
      keys: [N] PRNG keys.
      state: states to begin with, their leading axis N.
    """
    step, advise = jax.vmap(pomdp.step), jax.vmap(pomdp.expert)

    def once(carry: Any) -> Any:
        state, over, won, abstained, steps, t = carry
        drawn = jax.vmap(lambda key: jax.random.fold_in(key, t))(keys)
        advice = advise(drawn, state)
        abstained |= ~over & ~advice.valid
        over |= abstained
        state, result = step(drawn, state, advice.action)
        won |= ~over & result.success
        steps = jnp.where(over, steps, steps + 1)
        return state, over | result.terminated | result.truncated, won, abstained, steps, t + 1

    no = jnp.zeros(len(keys), bool)
    begin = (state, no, no, no, jnp.zeros(len(keys), jnp.int32), jnp.int32(0))
    run = jax.jit(lambda begin: jax.lax.while_loop(lambda c: ~jnp.all(c[1]), once, begin))
    _, _, won, abstained, steps, _ = run(begin)
    return Record(*map(np.asarray, (won, steps, abstained)))


if __name__ == "__main__":
    main()
