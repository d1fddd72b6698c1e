"""MiniGrid-MultiRoom: a chain of rooms of random sizes, each with a door to the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "traverse the rooms to get to the goal"

_MIN_SIZE = 4
_TRIES = 8  # Of placing the next room, before a chain is given up.
_FIRST_ENTRY = 2  # The wall by which one would enter the first room.


class _Rooms(NamedTuple):
    """Rooms with their walls: upper left cell, size and the door to the room before; int32[n, 2].

    `entry`, int32[n], is the wall that this door is in, numbered like directions.
    """

    top: jax.Array
    size: jax.Array
    door: jax.Array
    entry: jax.Array


@dataclass(frozen=True)
class MultiRoomSampler(TaskSampler):
    """A chain of `num_rooms` rooms with sides of 4 … `max_size` cells; all else is empty.

    Rooms do not overlap but for the wall with the door between two of them. The agent starts in
    the first room, the goal is in the last. A chain that cannot be continued is drawn again.

    Source: `MultiRoomEnv` of minigrid 3.2.0.
    """

    num_rooms: int
    max_size: int
    max_steps: int
    size: int = 25

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        chain_key, key = jax.random.split(key)
        count = 2 + 2 * _TRIES * (self.num_rooms - 1)
        rooms = placement.until_valid(chain_key, count, self._draw_chain)
        draws = jax.random.uniform(key, (self.num_rooms + 2,), jnp.float32)
        board = self._build(rooms, draws[3:])
        position, _ = placement.choose_cell(draws[0], self._free(board, rooms, 0))
        direction = placement.uniform_int(draws[1], 0, 4)
        goal, _ = placement.choose_cell(draws[2], self._free(board, rooms, -1))
        board = placement.put(board, goal, tiles.GOAL_TILE)
        state = placement.grid_state(board, position, direction)
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)

    def _draw_chain(self, draws: jax.Array) -> tuple[_Rooms, jax.Array]:
        """Makes a chain of rooms; returns it and whether it is complete."""
        column, rest = placement.split_draw(draws[0], self.size - 2)
        row = placement.uniform_int(rest, 0, self.size - 2)
        width, height, _ = self._draw_size(draws[1])
        top, size = jnp.stack([column, row]), jnp.stack([width, height])
        first = _Rooms(top, size, top, jnp.int32(_FIRST_ENTRY))
        fits = self._inside(first)

        nowhere = jnp.full((self.num_rooms, 2), -1, jnp.int32)
        rooms = _Rooms(nowhere, nowhere, nowhere, nowhere[:, 0])
        rooms = jax.tree.map(lambda all_, one: all_.at[0].set(one), rooms, first)

        def add(
            carry: tuple[_Rooms, jax.Array], item: tuple[jax.Array, jax.Array]
        ) -> tuple[tuple[_Rooms, jax.Array], None]:
            rooms, complete = carry
            number, draws = item
            last = jax.tree.map(lambda leaf: leaf[number - 1], rooms)
            tries = jax.vmap(self._draw_next, in_axes=(None, 0))(last, draws)
            earlier = jnp.arange(self.num_rooms, dtype=jnp.int32) < number - 1
            fits = jax.vmap(self._fits, in_axes=(0, None, None))(tries, rooms, earlier)
            chosen = jnp.argmax(fits)
            rooms = jax.tree.map(lambda all_, some: all_.at[number].set(some[chosen]), rooms, tries)
            return (rooms, complete & jnp.any(fits)), None

        numbers = jnp.arange(1, self.num_rooms, dtype=jnp.int32)
        tries = draws[2:].reshape(self.num_rooms - 1, _TRIES, 2)
        (rooms, complete), _ = jax.lax.scan(add, (rooms, fits), (numbers, tries))
        return rooms, complete

    def _draw_size(self, draw: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Returns a width and a height, and what is left of the draw."""
        sizes = self.max_size + 1 - _MIN_SIZE
        width, rest = placement.split_draw(draw, sizes)
        height, rest = placement.split_draw(rest, sizes)
        return _MIN_SIZE + width, _MIN_SIZE + height, rest

    def _draw_next(self, room: _Rooms, draws: jax.Array) -> _Rooms:
        """Draws one room behind a random door of `room`, which may not fit."""
        turn, rest = placement.split_draw(draws[0], 3)
        side = (room.entry + 1 + turn) % 4
        upright = side % 2 == 0  # The door is in the right or in the left wall.
        begins = side >= 2  # The door is in the left or in the upper wall.
        length = jnp.where(upright, room.size[1], room.size[0])
        along = placement.uniform_int(rest, 1, length - 1)
        across = jnp.where(begins, 0, jnp.where(upright, room.size[0], room.size[1]) - 1)
        door = room.top + jnp.where(upright, jnp.stack([across, along]), jnp.stack([along, across]))

        width, height, rest = self._draw_size(draws[1])
        extent = jnp.where(upright, height, width)
        back = placement.uniform_int(rest, 1, extent - 1)
        # The new room lies beyond its own wall with the door.
        depth = jnp.where(begins, jnp.where(upright, width, height) - 1, 0)
        top = door - jnp.where(upright, jnp.stack([depth, back]), jnp.stack([back, depth]))
        return _Rooms(top, jnp.stack([width, height]), door, (side + 2) % 4)

    def _inside(self, room: _Rooms) -> jax.Array:
        """Whether a room lies inside the grid; the lowest row is never used."""
        end = room.top + room.size
        return jnp.all(room.top >= 0) & (end[0] <= self.size) & (end[1] < self.size)

    def _fits(self, room: _Rooms, rooms: _Rooms, earlier: jax.Array) -> jax.Array:
        """Whether a room lies inside the grid and overlaps none of the `earlier` rooms.

        To the right of them and below it may touch them, to the left and above it may not.
        """
        apart = (room.top + room.size < rooms.top) | (rooms.top + rooms.size <= room.top)
        return self._inside(room) & jnp.all(jnp.any(apart, axis=1) | ~earlier)

    def _build(self, rooms: _Rooms, draws: jax.Array) -> jax.Array:
        """Returns the plane with walls and doors; one draw a door."""
        inside, core = self._covers(rooms, 0), self._covers(rooms, 1)
        wall = jnp.any(inside & ~core, axis=0)
        board = jnp.where(wall, jnp.uint8(tiles.WALL_TILE), jnp.uint8(tiles.EMPTY_TILE))
        color = placement.uniform_int(draws[0], 0, tiles.NUM_COLORS)
        for number in range(1, self.num_rooms):
            if number > 1:  # A door never has the colour of the door before.
                other = placement.uniform_int(draws[number - 1], 1, tiles.NUM_COLORS)
                color = (color + other) % tiles.NUM_COLORS
            door = (tiles.CLOSED_DOOR | color << tiles.COLOR_SHIFT).astype(jnp.uint8)
            board = placement.put(board, rooms.door[number], door)
        return board

    def _covers(self, rooms: _Rooms, margin: int) -> jax.Array:
        """Returns bool[n, size, size], where each room is, without its outer `margin`."""
        x, y = jnp.indices((self.size, self.size), jnp.int32)
        start, end = rooms.top + margin, rooms.top + rooms.size - margin
        in_x = (x >= start[:, 0, None, None]) & (x < end[:, 0, None, None])
        return in_x & (y >= start[:, 1, None, None]) & (y < end[:, 1, None, None])

    def _free(self, board: jax.Array, rooms: _Rooms, number: int) -> jax.Array:
        """Returns bool[size, size], the empty cells of a room."""
        one = jax.tree.map(lambda leaf: leaf[number][None], rooms)
        return self._covers(one, 0)[0] & (board == tiles.EMPTY_TILE)
