"""Several walkers in a corridor, each with an end to reach: `tests.corridor` for agents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.pomdp import (
    POMDP,
    Environment,
    Episode,
    ExpertAction,
    Outcome,
    Sensor,
    Task,
    TaskSampler,
)
from jaxact.spaces import Agents, Box, Discrete
from tests.corridor import CellAndGoal, Corridor, RandomStart, ReachEnd


@dataclass(frozen=True)
class Walkers(Environment):
    """State: int32 cells [A]."""

    agents: int
    length: int = 6

    @property
    def action_space(self) -> Agents:
        return Agents(Discrete(2), self.agents)

    def step(self, key: jax.Array, state: jax.Array, action: jax.Array) -> jax.Array:
        return jax.vmap(Corridor(self.length).step, (None, 0, 0))(key, state, action)


@dataclass(frozen=True)
class ReachEnds(Task):
    """Task state: int32 [A], the cells to reach; it ends when all are there."""

    step_penalty: float = -0.01

    def step(
        self, task_state: jax.Array, before: jax.Array, action: jax.Array, after: jax.Array
    ) -> tuple[jax.Array, Outcome]:
        each = jax.vmap(ReachEnd(self.step_penalty).step)
        _, outcome = each(task_state, before, action, after)
        return task_state, Outcome(
            reward=outcome.reward,
            success={"reached": jnp.all(outcome.success["reached"])},
            terminated=jnp.all(outcome.terminated),
            metrics={"distance": jnp.mean(outcome.metrics["distance"])},
        )

    def expert(self, key: jax.Array, task_state: jax.Array, state: jax.Array) -> ExpertAction:
        return jax.vmap(ReachEnd().expert, (None, 0, 0))(key, task_state, state)


@dataclass(frozen=True)
class RandomStarts(TaskSampler):
    agents: int
    length: int = 6
    horizon: int = 10

    def sample(self, key: jax.Array, sampler_state: Any) -> Episode:
        keys = key[None] if self.agents == 1 else jax.random.split(key, self.agents)
        sampler = RandomStart(self.length, self.horizon)
        episode = jax.vmap(sampler.sample, (0, None))(keys, sampler_state)
        return Episode(episode.environment, episode.task, jnp.int32(self.horizon))


@dataclass(frozen=True)
class CellsAndGoals(Sensor):
    agents: int
    length: int = 6

    @property
    def space(self) -> Agents:
        return Agents(Box(0, 1, (2 * self.length,), "float32"), self.agents)

    def observe(self, state: jax.Array, task_state: jax.Array) -> jax.Array:
        return jax.vmap(CellAndGoal(self.length).observe)(state, task_state)


def crowd(agents: int, length: int = 6, horizon: int = 10) -> POMDP:
    return POMDP(
        Walkers(agents, length),
        ReachEnds(),
        RandomStarts(agents, length, horizon),
        {"vector": CellsAndGoals(agents, length)},
    )
