"""A corridor to walk to its end: the smallest world with every part, for testing the library."""

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
from jaxact.spaces import Box, Discrete


@dataclass(frozen=True)
class Corridor(Environment):
    """State: int32 cell 0 … length − 1; actions: 0 left, 1 right."""

    length: int = 6

    @property
    def action_space(self) -> Discrete:
        return Discrete(2)

    def step(self, key: jax.Array, state: jax.Array, action: jax.Array) -> jax.Array:
        del key
        return jnp.clip(state + 2 * action - 1, 0, self.length - 1).astype(jnp.int32)


@dataclass(frozen=True)
class ReachEnd(Task):
    """Task state: int32 cell to reach."""

    step_penalty: float = -0.01

    def step(
        self, task_state: jax.Array, before: jax.Array, action: jax.Array, after: jax.Array
    ) -> tuple[jax.Array, Outcome]:
        del before, action
        reached = after == task_state
        return task_state, Outcome(
            reward={
                "success": reached.astype(jnp.float32),
                "step": jnp.asarray(self.step_penalty, jnp.float32),
            },
            success={"reached": reached},
            terminated=reached,
            metrics={"distance": jnp.abs(task_state - after).astype(jnp.float32)},
        )

    def expert(self, key: jax.Array, task_state: jax.Array, state: jax.Array) -> ExpertAction:
        del key
        return ExpertAction((task_state > state).astype(jnp.int32), state != task_state)


@dataclass(frozen=True)
class RandomStart(TaskSampler):
    length: int = 6
    horizon: int = 10

    def sample(self, key: jax.Array, sampler_state: Any) -> Episode:
        del sampler_state
        start_key, goal_key = jax.random.split(key)
        start = jax.random.randint(start_key, (), 1, self.length - 1, jnp.int32)
        goal = jax.random.randint(goal_key, (), 0, 2, jnp.int32) * (self.length - 1)
        return Episode(start, goal, jnp.int32(self.horizon))


@dataclass(frozen=True)
class CellAndGoal(Sensor):
    length: int = 6

    @property
    def space(self) -> Box:
        return Box(0, 1, (2 * self.length,), "float32")

    def observe(self, state: jax.Array, task_state: jax.Array) -> jax.Array:
        return jnp.concatenate(
            [jax.nn.one_hot(state, self.length), jax.nn.one_hot(task_state, self.length)]
        )


def corridor(length: int = 6, horizon: int = 10) -> POMDP:
    return POMDP(
        Corridor(length), ReachEnd(), RandomStart(length, horizon), {"vector": CellAndGoal(length)}
    )
