"""MiniGrid-LavaGap: a wall of lava with one gap between the agent and the goal."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "avoid the lava and get to the green goal square"


@dataclass(frozen=True)
class LavaGapSampler(TaskSampler):
    """A square of `size` cells a side, split by a column of lava with a gap.

    Source: `LavaGapEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (2,), jnp.float32)
        plane = placement.walled(self.size, self.size)
        column = placement.uniform_int(draws[0], 2, self.size - 2)
        gap = placement.uniform_int(draws[1], 1, self.size - 1)
        x, y = np.indices(plane.shape, np.int32)
        lava = (x == column) & (y != gap) & (plane == tiles.EMPTY_TILE)
        plane[-2, -2] = tiles.GOAL_TILE
        board = jnp.where(lava, jnp.uint8(tiles.LAVA_TILE), jnp.asarray(plane))
        state = placement.grid_state(board, jnp.ones(2, jnp.int32), jnp.int32(0))
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)
