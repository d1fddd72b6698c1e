"""What worlds of several agents are made of, besides the parts that worlds of one have too.

In such a world actions, rewards and readings have an axis of agents [A], see `jaxact.pomdp`; models
such as `jaxact.models.AgentsActorCritic` see it, and losses do not: to them the agents of a lane
are lanes side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Dependent, Expert, ExpertAction, Outcome, PyTree, Sensor, Task
from jaxact.spaces import Agents

if TYPE_CHECKING:
    from jaxact.losses.base import Batch


@dataclass(frozen=True)
class ForAll(Sensor):
    """One reading for all agents.

    Attributes:
      sensor: whose reading it is.
      agents: A, how many there are.
    """

    sensor: Sensor
    agents: int

    @property
    def space(self) -> Agents:
        """That of the sensor, for each agent."""
        return Agents(self.sensor.space, self.agents)

    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the reading [A, ...]."""
        reading = self.sensor.observe(state, task_state)
        return jnp.broadcast_to(reading, (self.agents, *reading.shape))


@dataclass(frozen=True)
class MixedRewards(Task):
    """A task of several agents in which each also earns of what the others do.

    Every component of the reward becomes own · rᵢ + others · Σⱼ≠ᵢ rⱼ. (1, 0) is the task itself,
    (1, 1) one reward for the team, and (1, α) the prosocial agents of A. Peysakhovich and A. Lerer,
    "Prosocial learning agents solve generalized Stag Hunts better than selfish ones", 2017. The
    task's expert, if it has one, is that of this task too.

    Attributes:
      task: whose rewards they are.
      own: weight of what an agent earns itself.
      others: weight of what each of the others earns.
    """

    task: Task
    own: float = 1.0
    others: float = 0.0

    def __new__(cls, task: Task | None = None, *args: Any, **kwargs: Any) -> MixedRewards:
        """Makes a task that can be demonstrated of one that can."""
        demonstrated = cls is MixedRewards and isinstance(task, Expert)
        return super().__new__(MixedRewardsWithExpert if demonstrated else cls)

    def check(self, pomdp: POMDP) -> None:
        """Refuses a world of one agent, and what the task refuses."""
        if not isinstance(pomdp.action_space, Agents):
            raise JaxactError(
                "rewards are mixed among several agents, and this is a world of one without an "
                "axis of agents"
            )
        if isinstance(self.task, Dependent):
            self.task.check(pomdp)

    def step(
        self, task_state: PyTree, before: PyTree, action: PyTree, after: PyTree
    ) -> tuple[PyTree, Outcome]:
        """Judges as the task does, and mixes."""
        task_state, outcome = self.task.step(task_state, before, action, after)

        def mix(reward: jax.Array) -> jax.Array:
            return (self.own - self.others) * reward + self.others * jnp.sum(reward)

        return task_state, replace(outcome, reward={n: mix(x) for n, x in outcome.reward.items()})


class MixedRewardsWithExpert(MixedRewards):
    """What `MixedRewards` makes of a task with an expert."""

    def expert(self, key: jax.Array, task_state: PyTree, state: PyTree) -> ExpertAction:
        """Returns the action of the task's expert."""
        assert isinstance(self.task, Expert)
        return self.task.expert(key, task_state, state)


def as_lanes(tree: PyTree, lead: int) -> PyTree:
    """Makes lanes of agents: [..., B, A, ...], B the last of `lead` axes, to [..., B · A, ...]."""

    def merge(x: jax.Array) -> jax.Array:
        return x.reshape(
            *x.shape[: lead - 1], x.shape[lead - 1] * x.shape[lead], *x.shape[lead + 1 :]
        )

    return jax.tree.map(merge, tree)


def as_agents(tree: PyTree, lead: int, agents: int) -> PyTree:
    """Undoes `as_lanes`."""

    def part(x: jax.Array) -> jax.Array:
        return x.reshape(*x.shape[: lead - 1], -1, agents, *x.shape[lead:])

    return jax.tree.map(part, tree)


def batch_of_lanes(batch: Batch, output: Any) -> tuple[Batch, Any]:
    """Lays a batch of several agents and the model's output on it out for losses.

    Args:
      batch: [T, B, A, ...].
      output: of the model, [T, B, A, ...].

    Returns:
      Both as of B · A lanes with one agent each, [T, B · A, ...]; without the model's memory.
    """
    agents = batch.terminated.shape[2]
    changed: dict[str, Any] = {}
    for name in _OF_AGENTS:
        changed[name] = as_lanes(getattr(batch, name), 2)
    for name in ("is_first", "weight"):
        value = getattr(batch, name)
        changed[name] = None if value is None else jnp.repeat(value, agents, axis=-1)
    keys = jax.vmap(lambda key: jax.random.split(key, agents))(batch.key)
    return replace(batch, **changed, key=keys.reshape(-1), memory=()), as_lanes(output, 2)


# Fields of a batch that each agent has its own of.
_OF_AGENTS = (
    *("observation", "previous_action", "action", "log_prob", "value", "reward", "reward_terms"),
    *("terminated", "truncated", "advantage", "normalized_advantage", "returns", "expert"),
)
