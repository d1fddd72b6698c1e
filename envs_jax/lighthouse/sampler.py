"""Where episodes in a lighthouse begin."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.lighthouse.environment import LighthouseState
from envs_jax.lighthouse.tasks import SearchState
from jaxact.pomdp import Episode, PyTree, TaskSampler


@dataclass(frozen=True)
class AnyCorner(TaskSampler):
    """Episodes that begin in the centre, with the goal in any corner."""

    dim: int
    radius: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        goal = jax.random.randint(key, (), 0, 2**self.dim, jnp.int32)
        start = LighthouseState(
            position=jnp.zeros(self.dim, jnp.int32),
            nearest=jnp.full(2**self.dim, self.radius, jnp.int32),
            last_action=jnp.int32(2 * self.dim),
        )
        horizon = jnp.int32(self.max_steps)
        return Episode(start, SearchState(goal, jnp.int32(0), horizon), horizon)
