"""MiniGrid-FourRooms: four rooms joined by four gaps; agent and goal anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "reach the goal"


@dataclass(frozen=True)
class FourRoomsSampler(TaskSampler):
    """A square of `size` cells a side, quartered by walls with one gap in each of their arms.

    Source: `FourRoomsEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (7,), jnp.float32)
        middle = self.size // 2
        plane = placement.walled(self.size, self.size)
        plane[middle, :] = tiles.WALL_TILE
        plane[:, middle] = tiles.WALL_TILE
        board = jnp.asarray(plane)
        near = [placement.uniform_int(draw, 1, middle) for draw in draws[:2]]
        far = [placement.uniform_int(draw, middle + 1, 2 * middle) for draw in draws[2:4]]
        for offset in (near[0], far[0]):
            board = placement.put(board, jnp.stack([jnp.int32(middle), offset]), tiles.EMPTY_TILE)
        for offset in (near[1], far[1]):
            board = placement.put(board, jnp.stack([offset, jnp.int32(middle)]), tiles.EMPTY_TILE)

        free = board == tiles.EMPTY_TILE
        position, _ = placement.choose_cell(draws[4], free)
        direction = placement.uniform_int(draws[5], 0, 4)
        goal, _ = placement.choose_cell(draws[6], free & ~placement.at(position, board.shape))
        board = placement.put(board, goal, tiles.GOAL_TILE)
        state = placement.grid_state(board, position, direction)
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)
