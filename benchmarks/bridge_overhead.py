"""What the bridge to Gymnasium costs: `python -m benchmarks.bridge_overhead --help`.

The same environments under random actions, stepped by Gymnasium's own vectors and by rollouts of
jaxact's through the bridge; all begin episodes anew, and take turns. With `--processes` there is
Gymnasium's `AsyncVectorEnv` besides, a process for each environment, and the bridge's processes.
Prints a line of JSON for the machine and one for each system.
"""

from __future__ import annotations

import functools
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

from benchmarks.env_lines import Line, print_lines
from benchmarks.env_worker import machine
from jaxact.distributions import Categorical, DiagonalNormal
from jaxact.errors import JaxactError
from jaxact.from_gymnasium import from_gymnasium
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import POMDP
from jaxact.rollout import SHORTEST_QUEUE_LENGTH, rollout, start_lanes
from jaxact.spaces import Discrete

PROGRAM = "benchmarks.bridge_overhead"


@dataclass(frozen=True)
class Arguments:
    """Times environments with and without the bridge, and prints lines of JSON."""

    ids: tuple[str, ...] = ("CartPole-v1",)
    """Environments, by Gymnasium's ids."""
    lanes: int = 32
    """Environments side by side."""
    steps: int = 256
    """Steps of each in a repeat."""
    repeats: int = 10
    """The fastest and the median are reported."""
    threads: int = 0
    """Threads of the bridge; see `from_gymnasium`."""
    processes: int = 0
    """Processes of the bridge; 0 to leave systems with processes out."""
    work: float = 0.0
    """Milliseconds of a processor by which each step of an environment is made heavier."""


# How many processes of its own each system has.
PROCESSES: dict[str, Callable[[Arguments], int]] = {
    "gymnasium": lambda _: 0,
    "rollout": lambda _: 0,
    "gymnasium_async": lambda arguments: arguments.lanes,
    "rollout_processes": lambda arguments: arguments.processes,
}


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        check(arguments)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)
    print_lines(measure(arguments), None)


def check(arguments: Arguments) -> None:
    """Checks numbers.

    Raises:
      JaxactError: one is too small.
    """
    for name in ("lanes", "steps", "repeats"):
        if getattr(arguments, name) < 1:
            raise JaxactError(f"--{name} must be at least 1; got {getattr(arguments, name)}")
    for name in ("threads", "processes", "work"):
        if getattr(arguments, name) < 0:
            raise JaxactError(f"--{name} must be at least 0; got {getattr(arguments, name)}")


def measure(arguments: Arguments) -> Iterator[Line]:
    """Yields the machine's line and those of each environment."""
    yield machine()
    for name in arguments.ids:
        yield from measure_environment(name, arguments)


def measure_environment(name: str, arguments: Arguments) -> Iterator[Line]:
    """Yields a line for each system."""
    make = functools.partial(made, name, arguments.work / 1000)
    systems = {
        "gymnasium": vector(SyncVectorEnv([make] * arguments.lanes), arguments),
        "rollout": through_rollout(make, arguments, threads=arguments.threads),
    }
    if arguments.processes:
        # A fork would take JAX's threads along.
        apart = AsyncVectorEnv([make] * arguments.lanes, context="spawn")
        systems["gymnasium_async"] = vector(apart, arguments)
        systems["rollout_processes"] = through_rollout(
            make, arguments, processes=arguments.processes
        )
    seconds: dict[str, list[float]] = {system: [] for system in systems}
    episodes = dict.fromkeys(systems, 0)
    for repeat in range(1 + arguments.repeats):
        for system, play in systems.items():
            began = time.perf_counter()
            ended = play()
            if repeat:
                seconds[system].append(time.perf_counter() - began)
                episodes[system] += ended
    steps = arguments.lanes * arguments.steps
    own = seconds["gymnasium"]
    for system, taken in seconds.items():
        yield {
            "id": name,
            "system": system,
            "steps_per_second": round(steps / min(taken)),
            "steps_per_second_median": round(steps / statistics.median(taken)),
            "microseconds_per_call": round(1e6 * statistics.median(taken) / arguments.steps, 1),
            "share_of_gymnasium": round(min(own) / min(taken), 3),
            "share_of_gymnasium_median": round(
                statistics.median(own) / statistics.median(taken), 3
            ),
            "episodes": episodes[system],
            "lanes": arguments.lanes,
            "steps": arguments.steps,
            "repeats": arguments.repeats,
            "threads": arguments.threads if system == "rollout" else 0,
            "processes": PROCESSES[system](arguments),
            "work_milliseconds": arguments.work,
        }


class Working(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Steps that take more of a processor, in Python.

    Attributes:
      seconds: by which each is longer.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any], seconds: float) -> None:
        super().__init__(environment)
        self.seconds = seconds

    def step(self, action: Any) -> Any:
        """Takes one step."""
        until = time.thread_time() + self.seconds
        while time.thread_time() < until:
            pass
        return super().step(action)


def made(name: str, work: float) -> gymnasium.Env[Any, Any]:
    """Makes an environment whose steps take `work` seconds more."""
    environment = gymnasium.make(name, disable_env_checker=True)
    return Working(environment, work) if work else environment


def vector(envs: VectorEnv[Any, Any, Any], arguments: Arguments) -> Callable[[], int]:
    """Returns a function that takes all steps with a vector of Gymnasium's, counting episodes."""
    envs.reset(seed=0)
    shape = (arguments.steps, arguments.lanes)
    random = np.random.default_rng(0)
    space: Any = envs.single_action_space
    if isinstance(space, gymnasium.spaces.Discrete):
        actions: np.ndarray = random.integers(space.n, size=shape)
    else:
        drawn = random.normal(size=(*shape, *space.shape))
        actions = np.clip(drawn, space.low, space.high).astype(space.dtype)

    def play() -> int:
        ended = 0
        for action in actions:
            _, _, terminated, truncated, _ = envs.step(action)
            ended += int(np.sum(terminated | truncated))
        return ended

    return play


class Random:
    """A policy without a memory."""

    @staticmethod
    def initial_memory(lanes: int) -> tuple[()]:
        """Returns nothing."""
        del lanes
        return ()


def random_policy(pomdp: POMDP) -> Callable[..., Any]:
    """Returns a policy that acts at random."""
    space = pomdp.action_space

    def policy(
        observation: dict[str, jax.Array], memory: Any, action: Any, is_first: jax.Array
    ) -> Any:
        del observation, action
        value = jnp.zeros(is_first.shape, jnp.float32)
        if isinstance(space, Discrete):
            return ActorCriticOutput(Categorical(jnp.zeros((*value.shape, space.n))), value), memory
        mean = jnp.zeros((*value.shape, *space.structure.shape), jnp.float32)
        return ActorCriticOutput(DiagonalNormal(mean, jnp.zeros_like(mean)), value), memory

    return policy


def through_rollout(
    make: Callable[[], gymnasium.Env[Any, Any]], arguments: Arguments, **options: int
) -> Callable[[], int]:
    """Returns the same through the bridge, by a rollout of jaxact's, compiled beforehand."""
    pomdp = from_gymnasium(make, simulators=arguments.lanes, **options)
    keys = jax.random.split(jax.random.key(0), arguments.lanes)
    lanes = start_lanes(pomdp, (), Random, keys, SHORTEST_QUEUE_LENGTH)
    policy = random_policy(pomdp)
    run = jax.jit(lambda lanes: rollout(pomdp, policy, (), lanes, arguments.steps))
    program = run.lower(lanes).compile()

    def play() -> int:
        nonlocal lanes
        lanes, trajectory = program(lanes)
        jax.block_until_ready((lanes, trajectory))
        return int(trajectory.step.finished.sum())

    return play


if __name__ == "__main__":
    main()
