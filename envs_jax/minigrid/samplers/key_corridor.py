"""MiniGrid-KeyCorridor: rooms off a corridor; the ball is behind a lock, the key is elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, rules, tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import LEFT, UP, RoomGrid, packed
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "pick up the {0} ball"


@dataclass(frozen=True)
class KeyCorridorSampler(TaskSampler):
    """Three columns of `rows` rooms of `room_size` × `room_size` cells.

    The middle column is the corridor, where the agent starts. The ball is in a locked room to the
    right, the key in a room to the left; shut doors in random places join all the rest.

    Source: `KeyCorridorEnv` of minigrid 3.2.0.
    """

    room_size: int
    rows: int
    max_steps: int

    @property
    def grid(self) -> RoomGrid:
        """The rooms."""
        return RoomGrid(self.room_size, 3, self.rows)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        grid = self.grid
        walls = 6 * self.rows
        draws = jax.random.uniform(key, (2 * walls + 7,), jnp.float32)
        offsets, doors = draws[: 2 * walls].reshape(2, *grid.walls)
        place, looks = draws[2 * walls : -2], draws[-2:]
        door, ball = (placement.uniform_int(draw, 0, tiles.NUM_COLORS) for draw in looks)
        ball_row, key_row = (placement.uniform_int(draw, 0, self.rows) for draw in place[:2])

        layout = grid.closed(offsets)
        for row in range(1, self.rows):
            layout = grid.remove_wall(layout, (1, row), UP)
        layout, _ = grid.add_door(layout, (2, ball_row), LEFT, door, True)
        layout, _ = grid.place(layout, (2, ball_row), packed(tiles.BALL, ball), place[2], mark=1)
        layout, _ = grid.place(layout, (0, key_row), packed(tiles.KEY, door), place[3])
        layout = grid.place_agent(layout, (1, self.rows // 2), place[4])
        layout = grid.connect_all(layout, doors)
        mission = missions.fill(MISSION, jnp.asarray(missions.COLOR_TOKENS)[ball])
        return placement.rule_episode(layout.state(), rules.PICK_UP, mission, self.max_steps)
