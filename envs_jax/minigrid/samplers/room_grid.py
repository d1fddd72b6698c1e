"""Levels made of a grid of equal rooms that share their walls: doors, objects, the agent.

A level grows by pure steps: each method of `RoomGrid` takes a `Layout` and returns the next one.
Chance comes in as uniform float32 draws in [0, 1), so that a level can draw all of its randomness
in one call. Wherever a room, a side or a colour is asked for, it may be static or computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.state import CONTENTS_SHIFT, GridState

# Sides of a room, numbered like the agent's directions.
RIGHT, DOWN, LEFT, UP = range(4)
KINDS = (tiles.KEY, tiles.BALL, tiles.BOX)

Int = jax.Array | int
Room = tuple[Int, Int]  # Its column and its row.


class Layout(NamedTuple):
    """A level in the making.

    The wall between two rooms belongs to the upper or the left one of them: index [0, column, row]
    is the right wall of a room, [1, column, row] its bottom wall. Those of the grid's own edge are
    there too, but no door is ever put into them.

    Attributes:
      plane: uint8[width, height], packed tiles.
      marks: uint16[width, height], see `GridState.marks`.
      offsets: int32[2, columns, rows], where along a wall its door would be, 1 … room_size - 2.
      joined: bool[2, columns, rows], the wall has a door or was removed.
      locked: bool[columns, rows], the last door added to the room, as that room's, was locked.
      used: bool[3, 6], what was placed so far: key, ball, box × colour.
      agent: int32[2], the agent's cell; before it is placed the middle of the middle room.
      direction: int32 scalar.
      valid: bool, everything found a place and all rooms that were to be joined could be.
    """

    plane: jax.Array
    marks: jax.Array
    offsets: jax.Array
    joined: jax.Array
    locked: jax.Array
    used: jax.Array
    agent: jax.Array
    direction: jax.Array
    valid: jax.Array

    def state(self) -> GridState:
        """Returns the first state of the level."""
        return placement.grid_state(self.plane, self.agent, self.direction, self.marks)


class Placed(NamedTuple):
    """Objects that were placed: packed tiles uint8[n], cells int32[n, 2], rooms int32[n, 2]."""

    codes: jax.Array
    cells: jax.Array
    rooms: jax.Array


def packed(kind: Int, color: Int) -> jax.Array:
    """Returns the packed tile, uint8, of a computed type and colour."""
    kind, color = jnp.asarray(kind, jnp.int32), jnp.asarray(color, jnp.int32)
    return (kind | color << tiles.COLOR_SHIFT).astype(jnp.uint8)


def contains_key(color: Int) -> jax.Array:
    """Returns the mark, uint16, of a box that contains the key of a colour."""
    return ((jnp.asarray(color, jnp.int32) + 1) << CONTENTS_SHIFT).astype(jnp.uint16)


def random_object(draw: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the packed tile of a random key, ball or box, and what is left of the draw."""
    look, rest = placement.split_draw(draw, len(KINDS) * tiles.NUM_COLORS)
    return packed(tiles.KEY + look % len(KINDS), look // len(KINDS)), rest


@dataclass(frozen=True)
class RoomGrid:
    """A grid of `columns` × `rows` rooms of `room_size` × `room_size` cells, walls included.

    Source: `RoomGrid` of minigrid 3.2.0. Where that gives up after many vain tries, or tries for
    ever, the layout becomes invalid here.
    """

    room_size: int
    columns: int
    rows: int

    @property
    def width(self) -> int:
        """Cells of the grid along x."""
        return self.columns * self._pitch + 1

    @property
    def height(self) -> int:
        """Cells of the grid along y."""
        return self.rows * self._pitch + 1

    @property
    def walls(self) -> tuple[int, int, int]:
        """The shape of the draws for something that every wall gets."""
        return (2, self.columns, self.rows)

    @property
    def _pitch(self) -> int:
        return self.room_size - 1

    @property
    def _inner(self) -> np.ndarray:
        """Bool[walls]: the wall lies between two rooms."""
        inner = np.ones(self.walls, bool)
        inner[0, -1, :] = inner[1, :, -1] = False
        return inner

    def closed(self, draws: jax.Array) -> Layout:
        """Returns bare rooms without doors; float32[walls] `draws` say where doors could be."""
        plane = np.full((self.width, self.height), tiles.EMPTY_TILE, np.uint8)
        plane[:: self._pitch, :] = tiles.WALL_TILE
        plane[:, :: self._pitch] = tiles.WALL_TILE
        middle = (self.columns // 2, self.rows // 2)
        center = [side * self._pitch + self.room_size // 2 for side in middle]
        return Layout(
            plane=jnp.asarray(plane),
            marks=jnp.zeros(plane.shape, jnp.uint16),
            offsets=placement.uniform_int(draws, 1, self._pitch),
            joined=jnp.zeros(self.walls, bool),
            locked=jnp.zeros((self.columns, self.rows), bool),
            used=jnp.zeros((len(KINDS), tiles.NUM_COLORS), bool),
            agent=jnp.asarray(center, jnp.int32),
            direction=jnp.int32(0),
            valid=jnp.bool_(True),
        )

    def random_room(self, draw: jax.Array) -> tuple[Room, jax.Array]:
        """Returns a uniform room, and what is left of the draw."""
        number, rest = placement.split_draw(draw, self.columns * self.rows)
        return (number // self.rows, number % self.rows), rest

    def room_at(self, cell: jax.Array) -> Room:
        """Returns the room of a cell; a shared wall counts as the right or the lower room's."""
        return cell[0] // self._pitch, cell[1] // self._pitch

    def in_room(self, room: Room) -> jax.Array:
        """Returns bool[width, height], true in the room and on its walls."""
        corner = self._corner(room)
        x = jnp.arange(self.width, dtype=jnp.int32)[:, None] - corner[0]
        y = jnp.arange(self.height, dtype=jnp.int32)[None, :] - corner[1]
        return (x >= 0) & (x < self.room_size) & (y >= 0) & (y < self.room_size)

    def free_sides(self, layout: Layout, room: Room) -> jax.Array:
        """Returns bool[4], the sides to which there is a neighbour, but no door or gap yet."""
        free = jnp.asarray(self._inner) & ~layout.joined
        edged = jnp.pad(free, ((0, 0), (1, 0), (1, 0)))
        sides = []
        for side in (RIGHT, DOWN, LEFT, UP):
            axis, column, row = _wall(room, side)
            sides.append(edged[axis, column + 1, row + 1])
        return jnp.stack(sides)

    def random_side(self, layout: Layout, room: Room, draw: jax.Array) -> jax.Array:
        """Returns a uniform one, int32, of `free_sides`; there must be one."""
        return placement.choose_cell(draw, self.free_sides(layout, room)[None])[0][1]

    def door_cell(self, layout: Layout, room: Room, side: Int) -> jax.Array:
        """Returns int32[2], where the door on a side of a room is or would be."""
        axis, column, row = _wall(room, side)
        along = layout.offsets[axis, column, row]
        is_right = jnp.asarray(axis, jnp.int32) == 0
        x = column * self._pitch + jnp.where(is_right, self._pitch, along)
        y = row * self._pitch + jnp.where(is_right, along, self._pitch)
        return jnp.stack([x, y])

    def add_door(
        self, layout: Layout, room: Room, side: Int, color: Int, locked: jax.Array | bool
    ) -> tuple[Layout, jax.Array]:
        """Puts a shut door into a wall; returns the layout and the door's cell int32[2]."""
        cell = self.door_cell(layout, room, side)
        locked = jnp.asarray(locked, bool)
        door = packed(jnp.where(locked, tiles.LOCKED_DOOR, tiles.CLOSED_DOOR), color)
        layout = layout._replace(
            plane=layout.plane.at[cell[0], cell[1]].set(door),
            joined=layout.joined.at[_wall(room, side)].set(True),
            locked=layout.locked.at[room].set(locked),
        )
        return layout, cell

    def remove_wall(self, layout: Layout, room: Room, side: Int) -> Layout:
        """Clears the wall on a side of a room, but for its ends."""
        axis, column, row = _wall(room, side)
        inside = self.in_room((column, row)) & self.in_room((column + 1 - axis, row + axis))
        corners = np.zeros((self.width, self.height), bool)
        corners[:: self._pitch, :: self._pitch] = True
        return layout._replace(
            plane=jnp.where(inside & ~corners, jnp.uint8(tiles.EMPTY_TILE), layout.plane),
            joined=layout.joined.at[axis, column, row].set(True),
        )

    def put(self, layout: Layout, cell: jax.Array, code: Int) -> Layout:
        """Puts a tile into a cell int32[2], whatever is there."""
        return layout._replace(
            plane=layout.plane.at[cell[0], cell[1]].set(jnp.asarray(code, jnp.uint8)),
            marks=layout.marks.at[cell[0], cell[1]].set(jnp.uint16(0)),
        )

    def place(
        self, layout: Layout, room: Room, code: Int, draw: jax.Array, mark: Int = 0
    ) -> tuple[Layout, jax.Array]:
        """Puts an object into a free cell of a room, two steps or more from the agent's.

        Returns:
          The layout, and the object's cell int32[2].
        """
        corner = self._corner(room)
        size = self.room_size
        cells = jax.lax.dynamic_slice(layout.plane, corner, (size, size))
        x, y = jnp.indices((size, size), jnp.int32)
        away_x, away_y = layout.agent[0] - corner[0] - x, layout.agent[1] - corner[1] - y
        far = jnp.abs(away_x) + jnp.abs(away_y) >= 2
        place, found = placement.choose_cell(draw, far & (cells == tiles.EMPTY_TILE))
        cell = place + jnp.stack(corner)
        code = jnp.asarray(code, jnp.uint8)
        number = code.astype(jnp.int32)
        look = (number & tiles.TYPE_MASK) - tiles.KEY, number >> tiles.COLOR_SHIFT
        layout = layout._replace(
            plane=layout.plane.at[cell[0], cell[1]].set(code),
            marks=layout.marks.at[cell[0], cell[1]].set(jnp.asarray(mark, jnp.uint16)),
            used=layout.used.at[look].set(True),
            valid=layout.valid & found,
        )
        return layout, cell

    def place_agent(self, layout: Layout, room: Room, draw: jax.Array) -> Layout:
        """Puts the agent into a room, its heading random, but never with a thing right ahead."""
        empty = placement.packed_rows(layout.plane == tiles.EMPTY_TILE)
        clear = empty | placement.packed_rows(layout.plane & tiles.TYPE_MASK == tiles.WALL)
        beyond = jnp.full(1, ~np.uint32(0))  # Walls, too.
        ahead = [
            jnp.concatenate([clear[1:], beyond]),
            clear >> 1 | jnp.uint32(1 << self.height - 1),
            jnp.concatenate([beyond, clear[:-1]]),
            clear << 1 | 1,
        ]
        poses = self._part(empty & jnp.stack(ahead), room)
        counts = jnp.sum(placement.bit_counts(poses), axis=1, dtype=jnp.int32)
        total = jnp.sum(counts, dtype=jnp.int32)
        rank = placement.uniform_int(draw, 0, total)
        direction, rank = placement.choose_ranked(rank, counts)
        rows = placement.entry(poses, direction)
        cell = placement.ranked_cell(rank, rows, self.room_size) + jnp.stack(self._corner(room))
        return layout._replace(agent=cell, direction=direction, valid=layout.valid & (total > 0))

    def _part(self, rows: jax.Array, room: Room) -> jax.Array:
        """Returns a room's part, uint32[..., room_size], of a grid packed into uint32[..., width].

        In both, bits are cells along y, from the grid's and from the room's upper wall on.
        """
        starts = range(0, self.columns * self._pitch, self._pitch)
        parts = jnp.stack([rows[..., start : start + self.room_size] for start in starts])
        _, top = self._corner(room)
        within = jnp.uint32(2**self.room_size - 1)
        return placement.entry(parts, room[0]) >> top.astype(jnp.uint32) & within

    def connect_all(
        self, layout: Layout, draws: jax.Array, colors: jax.Array | None = None
    ) -> Layout:
        """Adds shut doors in random places until every room can be reached from every other.

        No such door leads into a room, or out of one, that counts as `locked`.

        Args:
          layout: the level so far.
          draws: float32[walls].
          colors: bool[6], the colours that doors may have; all by default.
        """
        allowed = jnp.ones(tiles.NUM_COLORS, bool) if colors is None else colors
        looks, order = placement.split_draw(draws, jnp.sum(allowed, dtype=jnp.int32))
        ranks = jnp.cumsum(allowed, dtype=jnp.int32)
        looks = jnp.sum(ranks[None, None, None] <= looks[..., None], axis=-1, dtype=jnp.int32)

        # Doors come in the order of their draws; those that never come have 2, what is open −1.
        never = jnp.float32(2)
        right, down = layout.locked[1:, :], layout.locked[:, 1:]
        beyond = jnp.stack([jnp.pad(right, ((0, 1), (0, 0))), jnp.pad(down, ((0, 0), (0, 1)))])
        may_open = jnp.asarray(self._inner) & ~layout.joined & ~layout.locked[None] & ~beyond
        opens = jnp.where(layout.joined, -1, jnp.where(may_open, order, never))
        opens_right, opens_down = opens[0, :-1, :], opens[1, :, :-1]

        def relax(_: int, reached: jax.Array) -> jax.Array:
            """When each room is reached: over some neighbour, once both it and the wall are."""
            ways = [
                jnp.pad(way, pad, constant_values=never)
                for way, pad in (
                    (jnp.maximum(reached[:-1, :], opens_right), ((1, 0), (0, 0))),
                    (jnp.maximum(reached[1:, :], opens_right), ((0, 1), (0, 0))),
                    (jnp.maximum(reached[:, :-1], opens_down), ((0, 0), (1, 0))),
                    (jnp.maximum(reached[:, 1:], opens_down), ((0, 0), (0, 1))),
                )
            ]
            return jnp.min(jnp.stack([reached, *ways]), axis=0)

        start = jnp.full((self.columns, self.rows), never).at[0, 0].set(-1)
        reached = jax.lax.fori_loop(0, self.columns * self.rows - 1, relax, start)
        last = jnp.max(reached)
        added = may_open & (opens <= last)
        return self._with_doors(layout, added, looks)._replace(valid=layout.valid & (last < never))

    def door_cells(self, layout: Layout) -> jax.Array:
        """Returns int32[walls, 2], where the door in each wall is or would be."""
        axis, column, row = (jnp.asarray(index, jnp.int32) for index in np.indices(self.walls))
        cells = jax.vmap(self.door_cell, in_axes=(None, 0, 0))(
            layout, (column.reshape(-1), row.reshape(-1)), axis.reshape(-1)
        )
        return cells.reshape(*self.walls, 2)

    def _with_doors(self, layout: Layout, added: jax.Array, colors: jax.Array) -> Layout:
        """Puts shut doors, all at once, into the walls `added`, bool[walls]."""
        x, y = jnp.moveaxis(self.door_cells(layout), -1, 0)
        doors = jnp.where(added, packed(tiles.CLOSED_DOOR, colors), layout.plane[x, y])
        return layout._replace(plane=layout.plane.at[x, y].set(doors), joined=layout.joined | added)

    def add_distractors(
        self, layout: Layout, draws: jax.Array, room: Room | None = None, unique: bool = True
    ) -> tuple[Layout, Placed]:
        """Places random objects, one after the other.

        Args:
          layout: the level so far.
          draws: float32[n, 2] for n objects.
          room: where to put them; a random room each by default.
          unique: whether no object may look like another one, or like what was placed before.

        Returns:
          The layout, and the objects in the order in which they were placed.
        """
        # While they are placed, cells and looks are bits.
        near = placement.spread(
            placement.packed_rows(placement.at(layout.agent, (self.width, self.height)))
        )
        free = placement.packed_rows(layout.plane == tiles.EMPTY_TILE) & ~near
        looks = placement.packed_rows(~layout.used if unique else jnp.ones_like(layout.used))

        def add(
            state: tuple[jax.Array, jax.Array, jax.Array], pair: jax.Array
        ) -> tuple[tuple[jax.Array, jax.Array, jax.Array], Placed]:
            free, looks, valid = state
            where, draw = self.random_room(pair[0]) if room is None else (room, pair[0])
            look, any_look = placement.choose_packed(draw, looks, tiles.NUM_COLORS)
            cells = self._part(free, where)
            cell, any_cell = placement.choose_packed(pair[1], cells, self.room_size)
            cell += jnp.stack(self._corner(where))
            if unique:
                looks = placement.without(looks, look)
            code = packed(tiles.KEY + look[0], look[1])
            placed = Placed(code, cell, jnp.stack([jnp.asarray(n, jnp.int32) for n in where]))
            return (placement.without(free, cell), looks, valid & any_look & any_cell), placed

        (_, _, valid), placed = jax.lax.scan(add, (free, looks, layout.valid), draws)
        numbers = placed.codes.astype(jnp.int32)
        kinds, colors = (numbers & tiles.TYPE_MASK) - tiles.KEY, numbers >> tiles.COLOR_SHIFT
        layout = layout._replace(
            plane=layout.plane.at[placed.cells[:, 0], placed.cells[:, 1]].set(placed.codes),
            used=layout.used.at[kinds, colors].set(True),
            valid=valid,
        )
        return layout, placed

    def _corner(self, room: Room) -> tuple[jax.Array, jax.Array]:
        """Returns the room's upper left cell, on its walls."""
        column, row = (jnp.asarray(number, jnp.int32) for number in room)
        return column * self._pitch, row * self._pitch


def _wall(room: Room, side: Int) -> tuple[Int, Int, Int]:
    """Returns the index of the wall on a side of a room; see `Layout`."""
    axis, before = side & 1, side >> 1
    return axis, room[0] - before * (1 - axis), room[1] - before * axis
