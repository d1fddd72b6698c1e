"""MiniGrid-LockedRoom: six rooms off a hallway; the goal is in a locked one, its key in another."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import missions, tiles
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "get the {0} key from the {1} room, unlock the {0} door and go to the goal"

_ROOMS = 6  # Three on each side of the hallway: room r is on side r % 2, r // 2 from the top.


@dataclass(frozen=True)
class LockedRoomSampler(TaskSampler):
    """A square of 19 cells a side; every room has a door of its own colour.

    Source: `LockedRoomEnv` of minigrid 3.2.0.
    """

    max_steps: int
    size: int = 19

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (_ROOMS + 6,), jnp.float32)
        left, right = self.size // 2 - 2, self.size // 2 + 2
        pitch = self.size // 3
        plane = placement.walled(self.size, self.size)
        plane[[left, right], :] = tiles.WALL_TILE
        for side in (slice(0, left), slice(right, None)):
            plane[side, ::pitch] = tiles.WALL_TILE
        board = jnp.asarray(plane)

        colors = placement.order(draws[:_ROOMS])
        place = draws[_ROOMS:]
        locked = placement.uniform_int(place[0], 0, _ROOMS)
        # The key is in another room.
        key_room = (locked + placement.uniform_int(place[1], 1, _ROOMS)) % _ROOMS
        for room in range(_ROOMS):
            kind = jnp.where(locked == room, tiles.LOCKED_DOOR, tiles.CLOSED_DOOR)
            door = (kind | colors[room] << tiles.COLOR_SHIFT).astype(jnp.uint8)
            board = board.at[(left, right)[room % 2], room // 2 * pitch + 3].set(door)

        rooms = jnp.asarray(self._rooms(left, right, pitch))
        goal, _ = placement.choose_cell(place[2], rooms[locked])
        board = placement.put(board, goal, tiles.GOAL_TILE)
        key_cell, _ = placement.choose_cell(place[3], rooms[key_room])
        key_tile = (tiles.KEY | colors[locked] << tiles.COLOR_SHIFT).astype(jnp.uint8)
        board = placement.put(board, key_cell, key_tile)
        hallway = np.zeros_like(plane, bool)
        hallway[left + 1 : right, 1:-1] = True
        position, _ = placement.choose_cell(place[4], jnp.asarray(hallway))
        state = placement.grid_state(board, position, placement.uniform_int(place[5], 0, 4))

        words = jnp.asarray(missions.COLOR_TOKENS)
        mission = missions.fill(MISSION, words[colors[locked]], words[colors[key_room]])
        return placement.goal_episode(state, mission, self.max_steps)

    def _rooms(self, left: int, right: int, pitch: int) -> np.ndarray:
        """Returns bool[rooms, size, size], the inside of each room."""
        rooms = np.zeros((_ROOMS, self.size, self.size), bool)
        for room in range(_ROOMS):
            side = (slice(1, left), slice(right + 1, -1))[room % 2]
            top = room // 2 * pitch
            rooms[room, side, top + 1 : top + pitch] = True
        return rooms
