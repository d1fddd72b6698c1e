"""A POMDP in four replaceable parts: environment, task, task sampler and sensors.

Every part is a frozen, hashable dataclass of static choices; all that changes is a pytree of arrays
that its pure functions take and return. One lane (one world) is the unit: `jax.vmap` makes a batch.
Worlds never reset themselves; whoever steps them decides when the next episode begins.

A world of A agents has the action space `Agents(one agent's, A)`. Actions, the components of the
reward, an expert's advice and every sensor's reading then have a leading axis [A]. Episodes begin
and end for all agents together, and succeed or fail for all of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.frozen import FrozenMapping
from jaxact.spaces import Agents, Dict, Space

PyTree = Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episode:
    """What a task sampler yields: where an episode begins and when its time is up.

    Attributes:
      environment: the environment's first state.
      task: the task's first state.
      horizon: int32 scalar, steps after which the episode is truncated.
      origin: what the sampler wants to be told when the episode has ended, for example which part
        of a mixture drew it; None if nothing.
    """

    environment: PyTree
    task: PyTree
    horizon: jax.Array
    origin: PyTree = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """An episode in progress.

    Attributes:
      environment: the environment's state.
      task: the task's state.
      steps: int32 scalar, steps taken so far.
      horizon: int32 scalar, steps after which the episode is truncated.
      origin: of the episode, see `Episode`.
    """

    environment: PyTree
    task: PyTree
    steps: jax.Array
    horizon: jax.Array
    origin: PyTree = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Outcome:
    """What a task says of one step.

    Attributes:
      reward: named float32 components, [A] where there are several agents; the reward is their sum.
      success: named bool goal conditions; the episode succeeds when all hold.
      terminated: bool, whether the task has ended (its horizon is not the task's business).
      metrics: named float32 task metrics, for example SPL.
      truncated: bool, whether the world itself breaks the episode off, as simulators with limits of
        their own do; None if none ever does.
    """

    reward: Mapping[str, jax.Array]
    success: Mapping[str, jax.Array]
    terminated: jax.Array
    metrics: Mapping[str, jax.Array]
    truncated: jax.Array | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ExpertAction:
    """An expert's advice.

    Attributes:
      action: a value of the action space.
      valid: bool scalar, false where the expert abstains (the action is then to be ignored); [A]
        where there are several agents.
      policy: float32 [n], the expert's probabilities of n discrete actions, where it has more to
        say than one action; None if not. Teacher forcing takes `action`.
    """

    action: PyTree
    valid: jax.Array
    policy: jax.Array | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Step:
    """The result of one step.

    Attributes:
      observation: named arrays, one for each sensor, of the state just reached (at the end of an
        episode: its final observation).
      reward: float32 scalar, the sum of `reward_terms`; [A] where there are several agents.
      reward_terms: named float32 components, likewise.
      terminated: bool, the task has ended; nothing is bootstrapped.
      truncated: bool, the horizon was reached, or the world broke the episode off; both flags may
        be true.
      success: bool, all goal conditions hold.
      metrics: named float32 task metrics.
    """

    observation: dict[str, jax.Array]
    reward: jax.Array
    reward_terms: Mapping[str, jax.Array]
    terminated: jax.Array
    truncated: jax.Array
    success: jax.Array
    metrics: Mapping[str, jax.Array]

    @property
    def finished(self) -> jax.Array:
        """Bool: the episode is over, for either reason."""
        return self.terminated | self.truncated

    @property
    def info(self) -> dict[str, jax.Array]:
        """Scalars by flat names: "success", "reward/<component>" and "task/<metric>"."""
        return {
            "success": self.success,
            **{f"reward/{name}": value for name, value in self.reward_terms.items()},
            **{f"task/{name}": value for name, value in self.metrics.items()},
        }


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FinishedEpisodes:
    """How episodes ended, as told to `TaskSampler.update`; leading axes are [time, lane].

    Attributes:
      mask: bool, true where an episode ended at that step; elsewhere the rest is meaningless.
      success: bool.
      episode_return: float32, sum of rewards.
      length: int32, steps.
      task: the task's state at the end.
      origin: what the sampler noted in `Episode.origin`.
      mean_error: float32, mean |advantage| of those of the episode's steps that were taken in this
        rollout: how far the value was from what came.
    """

    mask: jax.Array
    success: jax.Array
    episode_return: jax.Array
    length: jax.Array
    task: PyTree
    origin: PyTree
    mean_error: jax.Array | None


class Environment(ABC):
    """The transition function. It knows no goals, rewards, horizons or sensors."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of discrete actions, for people to read; by default there are none."""
        return ()

    @property
    def max_lanes(self) -> int | None:
        """How many episodes can be in play at once; by default any number, None.

        A number says that the worlds lie outside of JAX, and that their states only refer to them.
        Episodes are then sampled when they begin, instead of ahead; a resumed run begins new ones.
        Those that are trained on and those held out are counted apart.
        """
        return None

    @property
    @abstractmethod
    def action_space(self) -> Space:
        """The actions `step` takes."""

    @abstractmethod
    def step(self, key: jax.Array, state: PyTree, action: PyTree) -> PyTree:
        """Returns the state that follows `state` under `action`."""


class Task(ABC):
    """The reward and the end of an episode. It knows nothing of learning or sampling.

    A task that can be demonstrated also defines `expert`; see `Expert`.
    """

    @abstractmethod
    def step(
        self, task_state: PyTree, before: PyTree, action: PyTree, after: PyTree
    ) -> tuple[PyTree, Outcome]:
        """Judges the step from environment state `before` to `after`."""


@runtime_checkable
class Expert(Protocol):
    """A task that can say what to do."""

    def expert(self, key: jax.Array, task_state: PyTree, state: PyTree) -> ExpertAction:
        """Returns the expert's action in environment state `state`."""
        ...


class TaskSampler(ABC):
    """The distribution of episodes: a pure function of a key and of the sampler's own state.

    A sampler that does not learn from how episodes went needs only `sample`.
    """

    @property
    def learns(self) -> bool:
        """Whether `update` is to be called; by default, whether it is overridden."""
        return type(self).update is not TaskSampler.update

    @property
    def held_out(self) -> TaskSampler:
        """The sampler of the episodes to evaluate on; by default this one, in its first state."""
        return self

    def init(self, key: jax.Array) -> PyTree:
        """Returns the sampler's first state; by default it has none."""
        del key
        return ()

    @abstractmethod
    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""

    def update(self, sampler_state: PyTree, finished: FinishedEpisodes) -> PyTree:
        """Learns from finished episodes, once per rollout; by default nothing."""
        del finished
        return sampler_state

    def kinds(self, origin: PyTree) -> Mapping[str, jax.Array]:
        """Tells named kinds of episodes apart, so that success is reported for each.

        Args:
          origin: of episodes, with any leading axes [...].

        Returns:
          Bool [...] by name, whether an episode is of that kind; by default there are no kinds.
        """
        del origin
        return {}

    def metrics(self, sampler_state: PyTree) -> Mapping[str, jax.Array]:
        """Returns named float32 scalars of the sampler's state to log; by default none."""
        del sampler_state
        return {}


@runtime_checkable
class Listed(Protocol):
    """A sampler of a list of episodes; evaluation plays each of them once, in order."""

    @property
    def count(self) -> int:
        """How many episodes there are."""
        ...

    def listed(self, index: jax.Array, sampler_state: PyTree) -> Episode:
        """Returns the episode at int32 `index` in 0 … `count` − 1."""
        ...


@runtime_checkable
class FollowsPolicy(Protocol):
    """A sampler whose state changes with what the policy learns, as that of past selves."""

    def check_model(self, model: Any) -> None:
        """Raises JaxactError if it cannot follow a policy with this model."""
        ...

    def follow(self, sampler_state: PyTree, params: PyTree) -> PyTree:
        """Returns the state to draw with; called before each rollout.

        Args:
          sampler_state: after the rollout before.
          params: those that the model acts with in this one.
        """
        ...


class Sensor(ABC):
    """One named part of the observation. It may look at the world and at the task."""

    @property
    @abstractmethod
    def space(self) -> Space:
        """Shape, dtype and bounds of what `observe` returns."""

    @abstractmethod
    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the reading in environment state `state`."""


@runtime_checkable
class Pictured(Protocol):
    """A sensor that can show a person what it sees."""

    def picture(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns an RGB frame, uint8 [H, W, 3]."""
        ...


@runtime_checkable
class Charted(Protocol):
    """An environment that can show a person the way that was taken so far."""

    def waypoint(self, state: PyTree) -> jax.Array:
        """Returns where the agent is, float32 [2]."""
        ...

    def chart(self, state: PyTree, task_state: PyTree, trail: jax.Array) -> jax.Array:
        """Returns an RGB frame, uint8 [H, W, 3].

        Args:
          state: how the world stands.
          task_state: the task's.
          trail: float32 [T, 2], the waypoints since the episode began; NaN for those to come.
        """
        ...


@runtime_checkable
class Worded(Protocol):
    """A sensor whose reading is text; works on the host, outside of `jit`."""

    def text(self, reading: jax.Array) -> str:
        """Puts a reading into words."""
        ...


@runtime_checkable
class Dependent(Protocol):
    """A part that has numbers of another part too, and refuses to work beside other ones."""

    def check(self, pomdp: POMDP) -> None:
        """Raises JaxactError if the POMDP's other parts disagree with this one."""
        ...


@dataclass(frozen=True)
class POMDP:
    """Environment, task, sampler and sensors, composed.

    Any part can be exchanged with `dataclasses.replace(pomdp, task=...)`. All methods are pure and
    work on one lane; `jax.vmap` them for a batch and `jax.jit` them for speed.
    """

    environment: Environment
    task: Task
    sampler: TaskSampler
    sensors: Mapping[str, Sensor]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensors", FrozenMapping(sorted(self.sensors.items())))
        for part in (self.task, self.sampler, *self.sensors.values()):
            if isinstance(part, Dependent):
                part.check(self)
        agents = self.num_agents
        for name, sensor in self.sensors.items():
            space = sensor.space
            if (space.count if isinstance(space, Agents) else 1) != agents:
                raise JaxactError(
                    f"sensor {name!r} must have a reading for each of {agents} agent(s), but its "
                    f"space is {space}; `jaxact.agents.ForAll` gives all agents one reading"
                )

    @property
    def action_space(self) -> Space:
        """The environment's actions."""
        return self.environment.action_space

    @property
    def num_agents(self) -> int:
        """How many act in it."""
        space = self.action_space
        return space.count if isinstance(space, Agents) else 1

    def check_single_agent(self, what: str) -> None:
        """Refuses a world of several agents, for what cannot do with it.

        Raises:
          JaxactError: there are several.
        """
        if isinstance(self.action_space, Agents):
            raise JaxactError(
                f"{what} for worlds of one agent, and this one is of {self.num_agents} agents; "
                "jaxact.opponents.against leaves one of them, beside given policies"
            )

    def lanes_at_once(self, wanted: int) -> int:
        """Returns how many of the episodes that are wanted can be played side by side."""
        limit = self.environment.max_lanes
        return wanted if limit is None else min(wanted, limit)

    def check_in_jax(self, what: str) -> None:
        """Refuses a world that lies outside of JAX, for what copies states or plays many at once.

        Raises:
          JaxactError: it does.
        """
        if self.environment.max_lanes is not None:
            raise JaxactError(
                f"{what} for worlds in JAX, and this one is simulated outside, where there are "
                f"{self.environment.max_lanes} lanes and no copies of a state"
            )

    @property
    def observation_space(self) -> Dict:
        """One named space for each sensor."""
        return Dict({name: sensor.space for name, sensor in self.sensors.items()})

    @property
    def has_expert(self) -> bool:
        """Whether the task can demonstrate itself."""
        return isinstance(self.task, Expert)

    def reset(
        self, key: jax.Array, sampler_state: PyTree | None = None
    ) -> tuple[State, dict[str, jax.Array]]:
        """Samples an episode; returns its first state and observation.

        Without `sampler_state` the sampler starts afresh.
        """
        init_key, sample_key = jax.random.split(key)
        if sampler_state is None:
            sampler_state = self.sampler.init(init_key)
        state = self.begin(self.sampler.sample(sample_key, sampler_state))
        return state, self.observe(state)

    def begin(self, episode: Episode) -> State:
        """Returns the first state of an episode."""
        horizon = jnp.asarray(episode.horizon, jnp.int32)
        steps = jnp.zeros_like(horizon)
        return State(episode.environment, episode.task, steps, horizon, episode.origin)

    def step(self, key: jax.Array, state: State, action: PyTree) -> tuple[State, Step]:
        """Takes one step; never resets.

        Args:
          key: a PRNG key, for worlds with chance in them.
          state: the state to step from.
          action: a value of `action_space`.

        Returns:
          The next state, and what was observed and earned.
        """
        environment = self.environment.step(key, state.environment, action)
        task, outcome = self.task.step(state.task, state.environment, action, environment)
        steps = state.steps + 1
        state = replace(state, environment=environment, task=task, steps=steps)
        reward = sum(outcome.reward.values(), start=jnp.float32(0))
        success = jnp.all(jnp.stack(list(outcome.success.values())), axis=0)
        truncated = steps >= state.horizon
        if outcome.truncated is not None:
            truncated |= outcome.truncated
        return state, Step(
            observation=self.observe(state),
            reward=reward,
            reward_terms=outcome.reward,
            terminated=outcome.terminated,
            truncated=truncated,
            success=success,
            metrics=outcome.metrics,
        )

    def observe(self, state: State) -> dict[str, jax.Array]:
        """Returns the reading of every sensor."""
        return {
            name: sensor.observe(state.environment, state.task)
            for name, sensor in self.sensors.items()
        }

    @property
    def has_pictures(self) -> bool:
        """Whether anything of it can be shown to a person."""
        sensors = self.sensors.values()
        charted = isinstance(self.environment, Charted)
        return charted or any(isinstance(sensor, Pictured) for sensor in sensors)

    def pictures(self, state: State, trail: jax.Array | None = None) -> dict[str, jax.Array]:
        """Returns RGB frames uint8 [H, W, 3].

        Args:
          state: what to show.
          trail: float32 [T, 2], see `Charted`; None for where the agent is, and no more.

        Returns:
          One of each sensor that can be pictured, and the "chart" of an environment that has one.
        """
        shown = {
            name: sensor.picture(state.environment, state.task)
            for name, sensor in self.sensors.items()
            if isinstance(sensor, Pictured)
        }
        if isinstance(self.environment, Charted):
            if trail is None:
                trail = self.environment.waypoint(state.environment)[None]
            shown["chart"] = self.environment.chart(state.environment, state.task, trail)
        return shown

    def words(self, observation: Mapping[str, jax.Array]) -> str:
        """Returns what the sensors that read text say, on the host; empty if there are none."""
        return "; ".join(
            sensor.text(observation[name])
            for name, sensor in self.sensors.items()
            if isinstance(sensor, Worded)
        )

    def expert(self, key: jax.Array, state: State) -> ExpertAction:
        """Returns the task's own advice.

        Raises:
          JaxactError: the task has no expert.
        """
        if not isinstance(self.task, Expert):
            raise JaxactError(
                f"{type(self.task).__name__} has no expert: imitation, teacher forcing and expert "
                "evaluation need a task with a method expert(key, task_state, state)"
            )
        return self.task.expert(key, state.task, state.environment)
