"""Levels with a locked door: open it, or pick up what is behind it."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import GO_TO, OPEN, PICK_UP
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.babyai.level import (
    LevelSampler,
    Shape,
    choose,
    clause,
    describe,
    like,
    random_color,
)
from envs_jax.minigrid.samplers.room_grid import RIGHT, Layout, Room, RoomGrid, contains_key, packed
from envs_jax.minigrid.sentences import DOOR, Sentence

_MIDDLE = (1, 1)


def _room_but(grid: RoomGrid, other: Room, draw: jax.Array) -> tuple[Room, jax.Array]:
    """Returns a uniform room that is not `other`, and what is left of the draw."""
    number, rest = placement.split_draw(draw, grid.columns * grid.rows - 1)
    number += (number >= other[0] * grid.rows + other[1]).astype(jnp.int32)
    return (number // grid.rows, number % grid.rows), rest


@dataclass(frozen=True)
class UnlockSampler(LevelSampler):
    """A maze with one room behind a locked door.

    The key may be in any room, even the locked one: the package means to keep it out, but does not.

    Attributes:
      objects_a_room: how many random objects there are in each room.
      go_to: whether to go to an object that lies in the locked room, instead of opening its door.

    Source: `Unlock` and `GoToImpUnlock` of minigrid 3.2.0.
    """

    objects_a_room: int = 3
    go_to: bool = False

    @property
    def beliefs(self) -> int:
        """How many of the first clauses can be of the kind "go to"."""
        return int(self.go_to)

    @property
    def mission_length(self) -> int:
        """Words of "go to the red ball", or "open the red door"."""
        return 5 if self.go_to else 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for room, side and colour of the lock, the key, doors, objects, agent, target."""
        rooms = self.grid.columns * self.grid.rows
        objects = (rooms * self.objects_a_room, 2)
        return (3,), (), (2,), self.grid.walls, objects, (), (2,)

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        lock, other_colors, key, doors, objects, agent, target = draws
        grid = self.grid
        locked_room, _ = grid.random_room(lock[0])
        color = random_color(lock[1])
        side = grid.random_side(layout, locked_room, lock[2])
        layout, _ = grid.add_door(layout, locked_room, side, color, True)
        key_room, _ = grid.random_room(key[0])
        layout, _ = grid.place(layout, key_room, packed(tiles.KEY, color), key[1])
        every = jnp.ones(tiles.NUM_COLORS, bool)
        if not self.go_to:  # Half of the time, no other door has the locked one's colour.
            every = every.at[color].set(other_colors >= 0.5)
        layout = grid.connect_all(layout, doors, every)

        rooms = [(i, j) for i in range(grid.columns) for j in range(grid.rows)]
        columns, rows = (
            jnp.repeat(jnp.array(numbers, jnp.int32), self.objects_a_room)
            for numbers in zip(*rooms, strict=True)
        )

        def add(
            layout: Layout, item: tuple[jax.Array, jax.Array, jax.Array]
        ) -> tuple[Layout, None]:
            column, row, pair = item
            layout, _ = grid.add_distractors(layout, pair[None], (column, row), unique=False)
            return layout, None

        layout, _ = jax.lax.scan(add, layout, (columns, rows, objects))
        room, agent = _room_but(grid, locked_room, agent)
        layout = grid.place_agent(layout, room, agent)
        reachable = placement.objects_reachable(layout.plane, layout.agent)
        layout = layout._replace(valid=layout.valid & reachable)
        if not self.go_to:
            return layout, clause(OPEN, describe(DOOR, color))
        layout, placed = grid.add_distractors(layout, target[None], locked_room, unique=False)
        return layout, clause(GO_TO, like(placed.codes[0]))


@dataclass(frozen=True)
class UnlockLocalSampler(LevelSampler):
    """A room with a locked door in one of its walls, to be opened, and the key in the room.

    Attributes:
      num_distractors: how many other objects there are, no two of them alike.
      in_box: whether the key is in a box.

    Source: `UnlockLocal` and `KeyInBox` of minigrid 3.2.0.
    """

    num_distractors: int = 0
    in_box: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "open the door"."""
        return 3

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the lock's side and colour, the key and its box, other objects, the agent."""
        return (2,), (2,), (self.num_distractors, 2), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        lock, key, others, agent = draws
        color = random_color(lock[1])
        side = self.grid.random_side(layout, _MIDDLE, lock[0])
        layout, _ = self.grid.add_door(layout, _MIDDLE, side, color, True)
        if self.in_box:
            box = packed(tiles.BOX, random_color(key[0]))
            layout, _ = self.grid.place(layout, _MIDDLE, box, key[1], contains_key(color))
        else:
            layout, _ = self.grid.place(layout, _MIDDLE, packed(tiles.KEY, color), key[1])
        if self.num_distractors > 0:
            layout, _ = self.grid.add_distractors(layout, others, _MIDDLE)
        layout = self.grid.place_agent(layout, _MIDDLE, agent)
        return layout, clause(OPEN, describe(DOOR))


@dataclass(frozen=True)
class UnlockPickupSampler(LevelSampler):
    """Two rooms with a locked door between them; pick up the box in the other one.

    Attributes:
      num_distractors: how many other objects there are, no two of them alike.
      blocked: whether a ball stands before the door. The mission then leaves the colour out.

    Source: `UnlockPickup` and `BlockedUnlockPickup` of minigrid 3.2.0.
    """

    num_distractors: int = 0
    blocked: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "pick up the red box", or "pick up the box"."""
        return 4 if self.blocked else 5

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the box, the lock, the ball before it, the key, other objects, the agent."""
        return (2,), (), (), (), (self.num_distractors, 2), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        box, lock, ball, key, others, agent = draws
        box_color, color = random_color(box[0]), random_color(lock)
        layout, _ = self.grid.place(layout, (1, 0), packed(tiles.BOX, box_color), box[1])
        layout, cell = self.grid.add_door(layout, (0, 0), RIGHT, color, True)
        if self.blocked:
            blocker = packed(tiles.BALL, random_color(ball))
            layout = self.grid.put(layout, cell.at[0].add(-1), blocker)
        layout, _ = self.grid.place(layout, (0, 0), packed(tiles.KEY, color), key)
        if self.num_distractors > 0:
            layout, _ = self.grid.add_distractors(layout, others)
        layout = self.grid.place_agent(layout, (0, 0), agent)
        what = describe(tiles.BOX) if self.blocked else describe(tiles.BOX, box_color)
        return layout, clause(PICK_UP, what)


@dataclass(frozen=True)
class UnlockToUnlockSampler(LevelSampler):
    """Three rooms in a row: the middle one has the key of the right, that one the key of the left.

    The agent starts in the middle; the ball to pick up is on the left.

    Source: `UnlockToUnlock` of minigrid 3.2.0.
    """

    @property
    def mission_length(self) -> int:
        """Words of "pick up the ball"."""
        return 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the two colours, two keys, the ball and the agent."""
        return (tiles.NUM_COLORS,), (2,), (2,), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        (left, right, *_), keys, ball, agent = placement.order(draws[0]), *draws[1:]
        layout, _ = self.grid.add_door(layout, (0, 0), RIGHT, left, True)
        layout, _ = self.grid.place(layout, (2, 0), packed(tiles.KEY, left), keys[0])
        layout, _ = self.grid.add_door(layout, (1, 0), RIGHT, right, True)
        layout, _ = self.grid.place(layout, (1, 0), packed(tiles.KEY, right), keys[1])
        code = packed(tiles.BALL, choose(ball[0], tiles.NUM_COLORS))
        layout, _ = self.grid.place(layout, (0, 0), code, ball[1])
        layout = self.grid.place_agent(layout, (1, 0), agent)
        return layout, clause(PICK_UP, describe(tiles.BALL))
