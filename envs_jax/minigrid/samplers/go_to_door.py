"""MiniGrid-GoToDoor: a room of random size with a door in each wall, one of them to go to."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, rules, tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import packed
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "go to the {0} door"

_MIN_SIZE = 5


@dataclass(frozen=True)
class GoToDoorSampler(TaskSampler):
    """A room with sides of 5 … `size` cells; outside of it all is empty. No two doors look alike.

    Source: `GoToDoorEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (tiles.NUM_COLORS + 9,), jnp.float32)
        place, looks = draws[:9], draws[9:]
        width, height = (
            placement.uniform_int(draw, _MIN_SIZE, self.size + 1) for draw in place[:2]
        )
        x, y = jnp.indices((self.size, self.size), jnp.int32)
        inside = (x > 0) & (x < width - 1) & (y > 0) & (y < height - 1)
        wall = (x < width) & (y < height) & ~inside
        board = jnp.where(wall, jnp.uint8(tiles.WALL_TILE), jnp.uint8(tiles.EMPTY_TILE))

        top, bottom = (placement.uniform_int(draw, 2, width - 2) for draw in place[2:4])
        left, right = (placement.uniform_int(draw, 2, height - 2) for draw in place[4:6])
        start = jnp.int32(0)
        doors = jnp.array([[top, start], [bottom, height - 1], [start, left], [width - 1, right]])
        colors = placement.order(looks)[:4]
        board = board.at[doors[:, 0], doors[:, 1]].set(packed(tiles.CLOSED_DOOR, colors))

        position, _ = placement.choose_cell(place[6], inside)
        state = placement.grid_state(board, position, placement.uniform_int(place[7], 0, 4))
        chosen = placement.uniform_int(place[8], 0, 4)
        mission = missions.fill(MISSION, jnp.asarray(missions.COLOR_TOKENS)[colors[chosen]])
        return placement.rule_episode(
            state, rules.GO_NEXT_TO, mission, self.max_steps, cells=[doors[chosen]]
        )
