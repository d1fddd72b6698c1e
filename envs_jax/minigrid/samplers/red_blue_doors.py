"""MiniGrid-RedBlueDoors: a room with a red door to the left and a blue one to the right."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import rules, tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "open the red door then the blue door"


@dataclass(frozen=True)
class RedBlueDoorsSampler(TaskSampler):
    """A room of `size` × `size` cells in the middle of a hall that is twice as wide.

    Source: `RedBlueDoorEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        size = self.size
        draws = jax.random.uniform(key, (4,), jnp.float32)
        left, right = size // 2, size // 2 + size - 1
        plane = placement.walled(2 * size, size)
        plane[[left, right], :] = tiles.WALL_TILE
        room = np.zeros(plane.shape, bool)
        room[left + 1 : right, 1:-1] = True
        position, _ = placement.choose_cell(draws[0], jnp.asarray(room))
        direction = placement.uniform_int(draws[1], 0, 4)

        board, cells = jnp.asarray(plane), []
        for draw, wall, color in ((draws[2], left, tiles.RED), (draws[3], right, tiles.BLUE)):
            cell = jnp.stack([jnp.int32(wall), placement.uniform_int(draw, 1, size - 1)])
            board = placement.put(board, cell, tiles.tile(tiles.CLOSED_DOOR, color))
            cells.append(cell)
        state = placement.grid_state(board, position, direction)
        return placement.rule_episode(
            state, rules.OPEN_IN_TURN, encode_mission(MISSION), self.max_steps, cells=cells
        )
