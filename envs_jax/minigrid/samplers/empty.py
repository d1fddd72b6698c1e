"""MiniGrid-Empty: a bare room with the goal in its far corner."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "get to the green goal square"


@dataclass(frozen=True)
class EmptySampler(TaskSampler):
    """A room of `size` × `size` cells.

    The agent starts in the near corner, facing right, or, with `random_start`, anywhere.

    Source: `EmptyEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int
    random_start: bool = False

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        plane = placement.walled(self.size, self.size)
        plane[-2, -2] = tiles.GOAL_TILE
        board = jnp.asarray(plane)
        if self.random_start:
            draws = jax.random.uniform(key, (2,), jnp.float32)
            position, _ = placement.choose_cell(draws[0], board == tiles.EMPTY_TILE)
            direction = placement.uniform_int(draws[1], 0, 4)
        else:
            position, direction = jnp.ones(2, jnp.int32), jnp.int32(0)
        state = placement.grid_state(board, position, direction)
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)
