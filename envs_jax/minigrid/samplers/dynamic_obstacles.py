"""MiniGrid-Dynamic-Obstacles: a room with the goal in its far corner, and balls that roam it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.obstacles import ObstacleState
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "get to the green goal square"

_BALL = tiles.tile(tiles.BALL, tiles.BLUE)


@dataclass(frozen=True)
class DynamicObstaclesSampler(TaskSampler):
    """A room of `size` × `size` cells with `num_obstacles` balls anywhere.

    The agent starts in the near corner, facing right, or, with `random_start`, anywhere.

    Source: `DynamicObstaclesEnv` of minigrid 3.2.0.
    """

    size: int
    num_obstacles: int
    max_steps: int
    random_start: bool = False

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (self.num_obstacles + 2,), jnp.float32)
        plane = placement.walled(self.size, self.size)
        plane[-2, -2] = tiles.GOAL_TILE
        board = jnp.asarray(plane)
        position, direction = jnp.ones(2, jnp.int32), jnp.int32(0)
        if self.random_start:
            position, _ = placement.choose_cell(draws[0], board == tiles.EMPTY_TILE)
            direction = placement.uniform_int(draws[1], 0, 4)
        elsewhere = ~placement.at(position, board.shape)

        def place(board: jax.Array, draw: jax.Array) -> tuple[jax.Array, jax.Array]:
            cell, _ = placement.choose_cell(draw, elsewhere & (board == tiles.EMPTY_TILE))
            return placement.put(board, cell, _BALL), cell

        board, obstacles = jax.lax.scan(place, board, draws[2:])
        world = placement.grid_state(board, position, direction)
        episode = placement.goal_episode(world, encode_mission(MISSION), self.max_steps)
        return replace(episode, environment=ObstacleState.of(world, obstacles))
