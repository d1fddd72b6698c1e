"""MiniGrid-ObstructedMaze: a ball behind locked doors, their keys in boxes, balls in the way."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, rules, tiles
from envs_jax.minigrid.environment import heading
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import (
    RIGHT,
    Int,
    Layout,
    Room,
    RoomGrid,
    contains_key,
    packed,
)
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "pick up the blue ball"

_TARGET = tiles.tile(tiles.BALL, tiles.BLUE)
_BLOCKER = tiles.tile(tiles.BALL, tiles.GREEN)
_BOX = tiles.tile(tiles.BOX, tiles.GREY)
_SIDE_ROOMS = ((2, 1), (1, 2), (0, 1), (1, 0))  # By the side of the middle room they are on.
_CORNERS = ((2, 0), (2, 2), (0, 2), (0, 0))


@dataclass(frozen=True)
class ObstructedMazeSampler(TaskSampler):
    """Rooms of 6 × 6 cells with locked doors between them.

    With no `quarters` there are two rooms and one door. Else there are three by three, and as many
    of the four quarters round the middle room are open: its door to a room on the side, and that
    room's locked doors to the corners next to it. The ball is in one of these corners. The key to a
    locked door is in the room before it.

    Attributes:
      quarters: 0 … 4.
      max_steps: the horizon.
      agent_room: where the agent starts.
      key_in_box: keys are hidden in boxes.
      blocked: balls lie before the locked doors.
      keys_last: a room's keys are placed after its doors and balls. Without, the second ball may
        replace the first key or its box: such levels cannot be solved, and the package makes them.

    Source: `ObstructedMaze_1Dlhb`, `ObstructedMaze_Full` and `ObstructedMaze_Full_V1` of
    minigrid 3.2.0.
    """

    quarters: int
    max_steps: int
    agent_room: tuple[int, int] = (0, 0)
    key_in_box: bool = False
    blocked: bool = False
    keys_last: bool = False

    @property
    def grid(self) -> RoomGrid:
        """The rooms."""
        return RoomGrid(6, 3, 3) if self.quarters else RoomGrid(6, 2, 1)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        grid = self.grid
        walls = 2 * grid.columns * grid.rows
        keys = max(1, 2 * self.quarters)
        draws = jax.random.uniform(key, (walls + keys + tiles.NUM_COLORS + 3,), jnp.float32)
        place, looks = draws[walls : -tiles.NUM_COLORS], draws[-tiles.NUM_COLORS :]
        colors = placement.order(looks)
        layout = grid.closed(draws[:walls].reshape(grid.walls))
        room: Room = (1, 0)
        if self.quarters:
            layout = self._open_quarters(layout, colors, place[3:])
            corners = jnp.array(_CORNERS[: self.quarters], jnp.int32)
            corner = corners[placement.uniform_int(place[0], 0, self.quarters)]
            room = corner[0], corner[1]
        else:
            layout = self._add_lock(layout, (0, 0), RIGHT, colors[0])
            layout = self._add_key(layout, (0, 0), colors[0], place[3])
        layout, _ = grid.place(layout, room, _TARGET, place[1], mark=1)
        layout = grid.place_agent(layout, self.agent_room, place[2])
        mission = missions.encode_mission(MISSION)
        return placement.rule_episode(layout.state(), rules.PICK_UP, mission, self.max_steps)

    def _open_quarters(self, layout: Layout, colors: jax.Array, draws: jax.Array) -> Layout:
        """Adds the doors of all quarters, their keys and balls; one draw a key."""

        def open_quarter(
            layout: Layout, item: tuple[jax.Array, jax.Array, jax.Array]
        ) -> tuple[Layout, None]:
            quarter, (column, row), draws = item
            room = column, row
            layout, _ = self.grid.add_door(layout, (1, 1), quarter, colors[quarter], False)
            # Each locked door with its colour and the draw for its key.
            locks = [
                ((quarter + turn) % 4, colors[(quarter + turn) % 6], draw)
                for turn, draw in zip((-1, 1), draws, strict=True)
            ]
            for side, color, draw in locks:
                layout = self._add_lock(layout, room, side, color)
                if not self.keys_last:
                    layout = self._add_key(layout, room, color, draw)
            if self.keys_last:
                for _, color, draw in locks:
                    layout = self._add_key(layout, room, color, draw)
            return layout, None

        numbers = jnp.arange(self.quarters, dtype=jnp.int32)
        rooms = jnp.array(_SIDE_ROOMS[: self.quarters], jnp.int32)
        return jax.lax.scan(open_quarter, layout, (numbers, rooms, draws.reshape(-1, 2)))[0]

    def _add_lock(self, layout: Layout, room: Room, side: Int, color: jax.Array) -> Layout:
        """Adds a locked door, and before it a ball if doors are blocked."""
        layout, cell = self.grid.add_door(layout, room, side, color, True)
        if self.blocked:
            layout = self.grid.put(layout, cell - heading(jnp.asarray(side, jnp.int32)), _BLOCKER)
        return layout

    def _add_key(self, layout: Layout, room: Room, color: jax.Array, draw: jax.Array) -> Layout:
        """Places a key, or a box with it."""
        if self.key_in_box:
            return self.grid.place(layout, room, _BOX, draw, contains_key(color))[0]
        return self.grid.place(layout, room, packed(tiles.KEY, color), draw)[0]
