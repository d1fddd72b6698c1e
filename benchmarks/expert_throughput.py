"""How fast experts answer: `python -m benchmarks.expert_throughput --help`.

Lanes are fresh levels, each some actions along the expert's own path. All of them are asked at once
by a program compiled ahead of time. Prints a line of JSON for the machine and one for each world.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import envs_jax
from benchmarks.env_lines import Line, print_lines
from benchmarks.env_worker import machine
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, State

DEFAULT_IDS = (
    "BabyAI-GoToLocal-v0",
    "MiniGrid-FourRooms-v0",
    "MiniGrid-DoorKey-8x8-v0",
    "BabyAI-BossLevel-v0",
    "MiniGrid-ObstructedMaze-Full-v1",
)
PROGRAM = "benchmarks.expert_throughput"
# The most actions along the expert's path; episodes that end sooner stay before their end.
OLDEST = 16


@dataclass(frozen=True)
class Arguments:
    """Times experts and prints lines of JSON."""

    ids: tuple[str, ...] = DEFAULT_IDS
    """Worlds, by Farama's ids."""
    lanes: int = 2048
    """Worlds side by side."""
    repeats: int = 20
    """Calls for all lanes; the fastest and the median are reported."""
    devices: int = 1
    """Devices that lanes are sharded over; on a CPU they are simulated."""
    seed: int = 0
    """Of everything random."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        check(arguments)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    print_lines(measure(arguments), None)


def check(arguments: Arguments) -> None:
    """Checks ids and numbers.

    Raises:
      JaxactError: an id, a world without expert, or a number that cannot be.
    """
    for name in ("lanes", "repeats", "devices"):
        if getattr(arguments, name) < 1:
            raise JaxactError(f"--{name} must be at least 1; got {getattr(arguments, name)}")
    if arguments.lanes % arguments.devices:
        raise JaxactError(
            f"{arguments.lanes} lanes cannot be divided among {arguments.devices} devices"
        )
    for name in arguments.ids:
        if not envs_jax.make(name).has_expert:
            raise JaxactError(f"{name!r} has no expert")


def measure(arguments: Arguments) -> Iterator[Line]:
    """Yields the machine's line and one for each world."""
    yield machine()
    for name in arguments.ids:
        yield measure_world(name, arguments)


def measure_world(name: str, arguments: Arguments) -> Line:
    """Returns the line of one world."""
    pomdp = replace(envs_jax.make(name), sensors={})
    keys = jax.random.split(jax.random.key(arguments.seed), arguments.lanes)
    mesh = Mesh(np.asarray(jax.devices()[: arguments.devices]), ("lanes",))
    spec = PartitionSpec("lanes")
    asked = jax.device_put((keys, draw_lanes(pomdp, keys)), NamedSharding(mesh, spec))
    began = time.perf_counter()
    # Each device searches as long as its own lanes need, not those of all.
    advise = jax.shard_map(
        jax.vmap(pomdp.expert), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False
    )
    program = jax.jit(advise).lower(*asked).compile()
    compile_seconds = time.perf_counter() - began
    seconds = []
    for _ in range(1 + arguments.repeats):
        began = time.perf_counter()
        jax.block_until_ready(program(*asked))
        seconds.append(time.perf_counter() - began)
    warm = seconds[1:]
    return {
        "id": name,
        "lanes": arguments.lanes,
        "plans_per_second": round(arguments.lanes / min(warm)),
        "plans_per_second_median": round(arguments.lanes / statistics.median(warm)),
        "compile_seconds": round(compile_seconds, 2),
        "repeats": arguments.repeats,
        "devices": arguments.devices,
    }


def draw_lanes(pomdp: POMDP, keys: jax.Array) -> State:
    """Returns states of fresh levels, each after 0 to `OLDEST` of the expert's actions."""
    ages = jnp.arange(len(keys), dtype=jnp.int32) % (OLDEST + 1)

    def once(t: Any, carry: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
        state, goes = carry
        drawn = jax.vmap(lambda key: jax.random.fold_in(key, t))(keys)
        advice = jax.vmap(pomdp.expert)(drawn, state)
        after, result = jax.vmap(pomdp.step)(drawn, state, advice.action)
        goes &= (t < ages) & advice.valid & ~(result.terminated | result.truncated)
        choose = jax.vmap(lambda go, new, old: jax.tree.map(partial(jnp.where, go), new, old))
        return choose(goes, after, state), goes

    begin = jax.vmap(lambda key: pomdp.reset(key)[0])
    goes = jnp.ones(len(keys), bool)
    return jax.jit(lambda: jax.lax.fori_loop(0, OLDEST, once, (begin(keys), goes))[0])()


if __name__ == "__main__":
    main()
