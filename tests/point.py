"""A point to steer to a goal in a square: the smallest world of continuous actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.pomdp import POMDP, Environment, Episode, Outcome, Sensor, Task, TaskSampler
from jaxact.spaces import Box


@dataclass(frozen=True)
class Plane(Environment):
    """State: float32 [2] in [−1, 1]; actions: the change of it, over `speed`."""

    speed: float = 0.3

    @property
    def action_space(self) -> Box:
        return Box(-1.0, 1.0, (2,))

    def step(self, key: jax.Array, state: jax.Array, action: jax.Array) -> jax.Array:
        del key
        return jnp.clip(state + self.speed * action, -1.0, 1.0)


@dataclass(frozen=True)
class ReachPoint(Task):
    """Task state: float32 [2], the point to reach."""

    def step(
        self, task_state: jax.Array, before: jax.Array, action: jax.Array, after: jax.Array
    ) -> tuple[jax.Array, Outcome]:
        del before, action
        distance = jnp.sqrt(jnp.sum(jnp.square(after - task_state)))
        reached = distance < 0.15
        reward = {"success": reached.astype(jnp.float32), "distance": -0.1 * distance}
        return task_state, Outcome(reward, {"reached": reached}, reached, {})


@dataclass(frozen=True)
class Anywhere(TaskSampler):
    horizon: int = 12

    def sample(self, key: jax.Array, sampler_state: Any) -> Episode:
        del sampler_state
        start, goal = jax.random.uniform(key, (2, 2), jnp.float32, -1.0, 1.0)
        return Episode(start, goal, jnp.int32(self.horizon))


@dataclass(frozen=True)
class PointAndGoal(Sensor):
    @property
    def space(self) -> Box:
        return Box(-1, 1, (4,), "float32")

    def observe(self, state: jax.Array, task_state: jax.Array) -> jax.Array:
        return jnp.concatenate([state, task_state])


def point() -> POMDP:
    return POMDP(Plane(), ReachPoint(), Anywhere(), {"vector": PointAndGoal()})
