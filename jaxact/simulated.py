"""Worlds that are simulated outside of JAX, as the parts of a POMDP.

Their states are tickets of `jaxact.simulators` and what was last seen. To sample an episode resets
a simulator, and a step of all lanes is one call to the host, which steps them there. The calls are
not ordered by JAX, which knows no order under `vmap` or on several devices: each step takes the
ticket that the one before returned, and the host refuses any other.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

from jaxact import simulators as hosts
from jaxact.compaction import together
from jaxact.errors import JaxactError, check_at_least
from jaxact.frozen import FrozenMapping
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.simulator_hosts import Host, LocalHost, Simulator
from jaxact.simulators import Simulators
from jaxact.spaces import Space


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SimulatedState:
    """Where an episode outside of JAX stands.

    Attributes:
      ticket: uint32 [6], see `simulators`.
      observation: the latest one, by the sensor's name.
      reward, episode_return: float32 scalars, of the last step and of all so far.
      terminated, truncated: bool scalars, what the simulator says.
      success: float32 scalar, 0 or 1, and -1 if the simulator does not say.
      metrics: float32 scalars by name.
    """

    ticket: jax.Array
    observation: dict[str, jax.Array]
    reward: jax.Array
    episode_return: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    success: jax.Array
    metrics: dict[str, jax.Array]

    @property
    def seed(self) -> jax.Array:
        """Uint32 scalar: what the simulator was reset to."""
        return jnp.asarray(hosts.seed_of(self.ticket[..., hosts.EPISODE]))

    @property
    def over(self) -> jax.Array:
        """Bool scalar: the episode has ended, or its time is up; no step changes it any more."""
        late = self.ticket[..., hosts.STEPS] >= self.ticket[..., hosts.HORIZON]
        return self.terminated | self.truncated | late


@dataclass(frozen=True)
class Simulated(Environment):
    """The transition function of simulators outside of JAX.

    Attributes:
      make: makes one.
      actions: their actions.
      observations: the space of each named part of what they observe.
      metrics: names of their metrics.
      simulators: at most how many there are for training, and how many for evaluation.
      threads: how many are stepped at once, see `simulator_hosts.LocalHost`.
      processes: how many processes of their own they are spread over; 0 for the caller's.
      timeout: seconds that one in such a process may take for an answer.
      kind: what errors call them.
      names: of discrete actions.
      make_held_out: makes one to evaluate with, of the same spaces; None if those are the same.
    """

    numbers_are_structure = True

    make: Callable[[], Simulator]
    actions: Space
    observations: Mapping[str, Space]
    metrics: tuple[str, ...] = ()
    simulators: int = 8
    threads: int = 0
    processes: int = 0
    timeout: float = 600.0
    kind: str = "worlds"
    names: tuple[str, ...] = ()
    make_held_out: Callable[[], Simulator] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "observations", FrozenMapping(self.observations))
        check_at_least(1, "a simulated world", simulators=self.simulators)
        check_at_least(0, "a simulated world", threads=self.threads, processes=self.processes)
        if self.threads and self.processes:
            raise JaxactError(
                f"{self.threads} threads and {self.processes} processes exclude each other: each "
                "process steps its own simulators one after the other"
            )
        if not isinstance(self.timeout, int | float) or not self.timeout > 0:
            raise JaxactError(
                f"timeout of a simulated world must be a number above 0, got {self.timeout!r}"
            )

    @property
    def action_names(self) -> tuple[str, ...]:
        """Those given."""
        return self.names

    @property
    def max_lanes(self) -> int:
        """The number of simulators."""
        return self.simulators

    @property
    def action_space(self) -> Space:
        """Those given."""
        return self.actions

    def begin(self, episode: jax.Array, horizon: jax.Array, held_out: bool) -> SimulatedState:
        """Resets a simulator.

        Args:
          episode: uint32 [2], its name, of which no other episode in play may be; `seed_of` it is
            the seed.
          horizon: int32 scalar, steps after which it is over.
          held_out: whether it is one to evaluate on; they have simulators of their own.
        """
        group = jnp.uint32(held_out)
        zero, limit = jnp.zeros((), jnp.uint32), jnp.asarray(horizon, jnp.uint32)
        ticket = jnp.stack([group, zero, episode[0], episode[1], zero, limit])

        @together
        def begin(tickets: jax.Array) -> PyTree:
            count = tickets.shape[0]
            shapes = (jax.ShapeDtypeStruct((count,), jnp.uint32), *self._shapes(count))
            call = hosts.called_back(functools.partial(_begin, self))
            return io_callback(call, shapes, tickets)

        number, *seen = begin(ticket)
        ticket = ticket.at[hosts.SIMULATOR].set(number)
        return self._state(ticket, jnp.zeros((), jnp.float32), *seen)

    def step(self, key: jax.Array, state: SimulatedState, action: PyTree) -> SimulatedState:
        """Steps the simulator; one whose episode is over stays as it is, and earns nothing.

        Raises:
          JaxactError: the action has the shape of none.
        """
        del key
        for given, expected in zip(
            jax.tree.leaves(action), jax.tree.leaves(self.actions.structure), strict=True
        ):
            if jnp.shape(given) != expected.shape:
                raise JaxactError(
                    f"an action of {self.kind} has the shape {expected.shape}, not "
                    f"{jnp.shape(given)}"
                )

        @together
        def step(tickets: jax.Array, active: jax.Array, *actions: jax.Array) -> PyTree:
            shapes = self._shapes(tickets.shape[0])
            call = hosts.called_back(functools.partial(_step, self))
            return io_callback(call, shapes, tickets, active, *actions)

        seen = step(state.ticket, ~state.over, *jax.tree.leaves(action))
        after = self._state(state.ticket.at[hosts.STEPS].add(1), state.episode_return, *seen)
        stays = replace(state, reward=jnp.zeros_like(state.reward))
        return jax.tree.map(lambda a, b: jnp.where(state.over, a, b), stays, after)

    def pool(self, held_out: bool) -> Simulators:
        """Returns the simulators for training, or those for evaluation."""
        return _pool(self, held_out)

    def close(self) -> None:
        """Closes all simulators that there are."""
        for held_out in (False, True):
            self.pool(held_out).close()

    def _shapes(self, lanes: int) -> tuple[jax.ShapeDtypeStruct, ...]:
        """Returns the shapes of numbers and observations."""
        numbers = jax.ShapeDtypeStruct((lanes, hosts.SUCCESS + 1 + len(self.metrics)), jnp.float32)
        seen = [space.structure for space in self.observations.values()]
        batched = [jax.ShapeDtypeStruct((lanes, *x.shape), x.dtype) for x in seen]
        return numbers, *batched

    def _state(
        self, ticket: jax.Array, so_far: jax.Array, numbers: jax.Array, *seen: jax.Array
    ) -> SimulatedState:
        metrics = numbers[hosts.SUCCESS + 1 :]
        return SimulatedState(
            ticket=ticket,
            observation=dict(zip(self.observations, seen, strict=True)),
            reward=numbers[hosts.REWARD],
            episode_return=so_far + numbers[hosts.REWARD],
            terminated=numbers[hosts.TERMINATED] != 0,
            truncated=numbers[hosts.TRUNCATED] != 0,
            success=numbers[hosts.SUCCESS],
            metrics={name: metrics[i] for i, name in enumerate(self.metrics)},
        )


@functools.cache
def _pool(environment: Simulated, held_out: bool) -> Simulators:
    make = (environment.make_held_out if held_out else None) or environment.make
    shapes = [space.structure for space in environment.observations.values()]
    host: Host = LocalHost(make, environment.threads)
    if environment.processes:
        from jaxact.simulator_processes import ProcessHost

        # No more than there are simulators for.
        processes = min(environment.processes, environment.simulators)
        host = ProcessHost(make, processes, environment.timeout)
    metrics = len(environment.metrics)
    return Simulators(host, environment.simulators, shapes, metrics, environment.kind)


def _begin(environment: Simulated, tickets: np.ndarray) -> tuple[np.ndarray, ...]:
    return _pool_of(environment, tickets).begin(tickets)


def _step(
    environment: Simulated, tickets: np.ndarray, active: np.ndarray, *actions: np.ndarray
) -> tuple[np.ndarray, ...]:
    return _pool_of(environment, tickets).step(tickets, active, *actions)


def _pool_of(environment: Simulated, tickets: np.ndarray) -> Simulators:
    # The lanes of a call are all of one kind, but for those that have not begun and are not moved.
    return environment.pool(bool(tickets[:, hosts.HELD_OUT].any()))


@dataclass(frozen=True)
class SimulatedEpisodes(TaskSampler):
    """Begins episodes of simulators outside of JAX, each with a seed that is drawn.

    Attributes:
      environment: the simulators.
      horizon: steps after which an episode is truncated, if the simulator did not end it before.
      held_out_seeds: evaluation is on the seeds 0 … N − 1; 0 for seeds that are drawn.
      is_held_out: whether episodes are to evaluate on.
    """

    environment: Simulated
    horizon: int = 2**31 - 1
    held_out_seeds: int = 0
    is_held_out: bool = False

    def __post_init__(self) -> None:
        check_at_least(1, "simulated episodes", horizon=self.horizon)
        check_at_least(0, "simulated episodes", held_out_seeds=self.held_out_seeds)

    @property
    def held_out(self) -> TaskSampler:
        """The same with simulators of their own, or with the list of seeds."""
        if self.held_out_seeds:
            return SimulatedSeeds(self.environment, self.held_out_seeds, self.horizon)
        return replace(self, is_held_out=True)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Resets a simulator."""
        del sampler_state
        episode = jax.random.bits(key, (2,), jnp.uint32)
        return _begin_episode(self.environment, episode, self.horizon, self.is_held_out)

    def check(self, pomdp: POMDP) -> None:
        """Refuses other simulators than the sampler's."""
        if pomdp.environment != self.environment:
            raise JaxactError(
                "the sampler begins episodes of other simulators than the environment steps: "
                "exchange both, as in override(pomdp, {'environment.simulators': n, "
                "'sampler.environment.simulators': n})"
            )


@dataclass(frozen=True)
class SimulatedSeeds(TaskSampler):
    """Held-out episodes of simulators outside of JAX, one for each of the seeds 0 … N − 1.

    Attributes:
      environment: the simulators.
      count: N.
      horizon: steps after which an episode is truncated.
    """

    environment: Simulated
    count: int
    horizon: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Begins one of them."""
        return self.listed(jax.random.randint(key, (), 0, self.count, jnp.int32), sampler_state)

    def listed(self, index: jax.Array, sampler_state: PyTree) -> Episode:
        """Resets a simulator to the seed that the int32 scalar is."""
        del sampler_state
        seed = jnp.asarray(index, jnp.uint32)
        episode = jnp.stack([seed << 1, jnp.zeros_like(seed)])
        return _begin_episode(self.environment, episode, self.horizon, held_out=True)


def _begin_episode(
    environment: Simulated, episode: jax.Array, horizon: int, held_out: bool
) -> Episode:
    limit = jnp.int32(horizon)
    return Episode(environment.begin(episode, limit, held_out), task=(), horizon=limit)


@dataclass(frozen=True)
class SimulatedTask(Task):
    """The reward and the ends that the simulators themselves say.

    An episode is a success if the simulator says so; of one that does not say, if its return is
    enough.

    Attributes:
      success_return: how much is enough.
    """

    success_return: float = float("inf")

    def step(
        self, task_state: PyTree, before: SimulatedState, action: PyTree, after: SimulatedState
    ) -> tuple[PyTree, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        enough = after.episode_return >= jnp.asarray(self.success_return, jnp.float32)
        return task_state, Outcome(
            reward={"reward": after.reward},
            success={"goal": jnp.where(after.success < 0, enough, after.success > 0)},
            terminated=after.terminated,
            metrics=after.metrics,
            truncated=after.truncated,
        )


@dataclass(frozen=True)
class SimulatedSensor(Sensor):
    """A named part of what a simulator observes.

    Attributes:
      name: of the part.
      values: its space.
    """

    numbers_are_structure = True

    name: str
    values: Space

    @property
    def space(self) -> Space:
        """That of the part."""
        return self.values

    def observe(self, state: SimulatedState, task_state: PyTree) -> jax.Array:
        """Returns the latest reading."""
        del task_state
        return state.observation[self.name]


@dataclass(frozen=True)
class SimulatedCamera(SimulatedSensor):
    """The same of an RGB image, uint8 [H, W, 3]."""

    def picture(self, state: SimulatedState, task_state: PyTree) -> jax.Array:
        """Returns the latest image."""
        return self.observe(state, task_state)
