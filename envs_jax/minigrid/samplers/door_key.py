"""MiniGrid-DoorKey: a locked door between the agent, who finds the key, and the goal."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "use the key to open the door and then get to the goal"


@dataclass(frozen=True)
class DoorKeySampler(TaskSampler):
    """A square of `size` cells a side, split by a wall with a locked yellow door.

    Source: `DoorKeyEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        size = self.size
        draws = jax.random.uniform(key, (5,), jnp.float32)
        plane = placement.walled(size, size)
        plane[-2, -2] = tiles.GOAL_TILE
        columns = jnp.arange(size, dtype=jnp.int32)[:, None]
        split = placement.uniform_int(draws[0], 2, size - 2)
        board = jnp.where(columns == split, jnp.uint8(tiles.WALL_TILE), jnp.asarray(plane))
        door = jnp.stack([split, placement.uniform_int(draws[1], 1, size - 2)])
        board = placement.put(board, door, tiles.tile(tiles.LOCKED_DOOR, tiles.YELLOW))

        free = (board == tiles.EMPTY_TILE) & (columns < split)
        position, _ = placement.choose_cell(draws[2], free)
        direction = placement.uniform_int(draws[3], 0, 4)
        key_cell, _ = placement.choose_cell(draws[4], free & ~placement.at(position, board.shape))
        board = placement.put(board, key_cell, tiles.tile(tiles.KEY, tiles.YELLOW))
        state = placement.grid_state(board, position, direction)
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)
