"""MiniGrid-DistShift: two strips of lava, the second of which may lie elsewhere."""

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
class DistShiftSampler(TaskSampler):
    """A room of 9 × 7 cells with lava on its first row and on row `strip`; always the same.

    Source: `DistShiftEnv` of minigrid 3.2.0.
    """

    strip: int
    max_steps: int
    width: int = 9
    height: int = 7

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Returns the episode; `key` is not used."""
        del key, sampler_state
        plane = placement.walled(self.width, self.height)
        plane[3:-3, [1, self.strip]] = tiles.LAVA_TILE
        plane[-2, 1] = tiles.GOAL_TILE
        state = placement.grid_state(jnp.asarray(plane), jnp.ones(2, jnp.int32), jnp.int32(0))
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)
