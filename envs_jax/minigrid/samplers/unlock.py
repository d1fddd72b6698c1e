"""MiniGrid-Unlock, -UnlockPickup and -BlockedUnlockPickup: two rooms and a locked door."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, rules, tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import RIGHT, RoomGrid, packed
from jaxact.pomdp import Episode, PyTree, TaskSampler

OPEN_MISSION = "open the door"
PICKUP_MISSION = "pick up the {0} box"

_GRID = RoomGrid(6, 2, 1)
_WALLS = 4
_NEAR, _FAR = (0, 0), (1, 0)


@dataclass(frozen=True)
class UnlockSampler(TaskSampler):
    """Two rooms of 6 × 6 cells; the agent and the key to the door are in the first one.

    The task is to open the door or, with `pickup`, to take the box that is behind it. With
    `blocked` a ball lies before the door.

    Source: `UnlockEnv`, `UnlockPickupEnv` and `BlockedUnlockPickupEnv` of minigrid 3.2.0.
    """

    max_steps: int
    pickup: bool = False
    blocked: bool = False

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (_WALLS + 6,), jnp.float32)
        place, looks = draws[_WALLS:-3], draws[-3:]
        box, door, ball = (placement.uniform_int(draw, 0, tiles.NUM_COLORS) for draw in looks)
        layout = _GRID.closed(draws[:_WALLS].reshape(_GRID.walls))
        if self.pickup:
            layout, _ = _GRID.place(layout, _FAR, packed(tiles.BOX, box), place[0], mark=1)
        layout, door_cell = _GRID.add_door(layout, _NEAR, RIGHT, door, True)
        if self.blocked:
            layout = _GRID.put(layout, door_cell.at[0].add(-1), packed(tiles.BALL, ball))
        layout, _ = _GRID.place(layout, _NEAR, packed(tiles.KEY, door), place[1])
        layout = _GRID.place_agent(layout, _NEAR, place[2])
        if self.pickup:
            mission = missions.fill(PICKUP_MISSION, jnp.asarray(missions.COLOR_TOKENS)[box])
            return placement.rule_episode(layout.state(), rules.PICK_UP, mission, self.max_steps)
        return placement.rule_episode(
            layout.state(),
            rules.OPEN,
            missions.encode_mission(OPEN_MISSION),
            self.max_steps,
            cells=[door_cell],
        )
