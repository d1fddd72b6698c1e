"""Levels with a single object to be picked up, in one room or somewhere in a maze."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import PICK_UP
from envs_jax.minigrid.samplers.babyai.level import (
    LevelSampler,
    Shape,
    choose,
    clause,
    describe,
    random_color,
)
from envs_jax.minigrid.samplers.room_grid import LEFT, UP, Layout, packed, random_object
from envs_jax.minigrid.sentences import ANY_COLOR, ANY_KIND, Sentence, color_of, kind_of

_MIDDLE = (1, 1)


@dataclass(frozen=True)
class OneRoomSampler(LevelSampler):
    """A bare room with one ball.

    Source: `OneRoomS8` of minigrid 3.2.0.
    """

    @property
    def mission_length(self) -> int:
        """Words of "pick up the ball"."""
        return 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the ball and the agent."""
        return (2,), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        ball = packed(tiles.BALL, random_color(draws[0][0]))
        layout, _ = self.grid.place(layout, (0, 0), ball, draws[0][1])
        layout = self.grid.place_agent(layout, (0, 0), draws[1])
        return layout, clause(PICK_UP, describe(tiles.BALL))


@dataclass(frozen=True)
class PickupDistSampler(LevelSampler):
    """A room with objects, no two of them alike; one is known by its type, its colour, or both.

    Attributes:
      num_objects: how many objects there are.
      strict: whether to pick up another object is to fail.

    Source: `PickupDist` of minigrid 3.2.0.
    """

    num_objects: int = 5
    strict: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "pick up the red object"."""
        return 5

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the objects, the agent, which object, and how it is known."""
        return (self.num_objects, 2), (), (), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        objects, agent, choice, known_by = draws
        layout, placed = self.grid.add_distractors(layout, objects, (0, 0))
        layout = self.grid.place_agent(layout, (0, 0), agent)
        code = placed.codes[choose(choice, self.num_objects)]
        mode = choose(known_by, 3)
        color = color_of(code)
        what = describe(
            jnp.where(mode == 1, ANY_KIND, kind_of(code)), jnp.where(mode == 0, ANY_COLOR, color)
        )
        return layout, clause(PICK_UP, what, strict=self.strict)


@dataclass(frozen=True)
class FindObjSampler(LevelSampler):
    """A maze with one object in it; the agent starts in the middle.

    Attributes:
      above: whether the object is in the room above, behind a door for certain, and the mission
        tells its colour; else it is anywhere.

    Source: `FindObjS5` and `PickupAbove` of minigrid 3.2.0.
    """

    above: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "pick up the red ball", or "pick up the ball"."""
        return 5 if self.above else 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the object and its room, the door above, the agent, and other doors."""
        return (3,), (), (), self.grid.walls

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        thing, door, agent, doors = draws
        code, _ = random_object(thing[0])
        room = (1, 0) if self.above else self.grid.random_room(thing[1])[0]
        layout, _ = self.grid.place(layout, room, code, thing[2])
        if self.above:
            layout, _ = self.grid.add_door(layout, _MIDDLE, UP, random_color(door), False)
        layout = self.grid.place_agent(layout, _MIDDLE, agent)
        layout = self.grid.connect_all(layout, doors)
        color = color_of(code) if self.above else ANY_COLOR
        return layout, clause(PICK_UP, describe(kind_of(code), color))


@dataclass(frozen=True)
class KeyCorridorSampler(LevelSampler):
    """A corridor between two columns of rooms: a ball on the right, locked up; its key on the left.

    Source: `KeyCorridor` of minigrid 3.2.0 (the one of BabyAI).
    """

    @property
    def mission_length(self) -> int:
        """Words of "pick up the ball"."""
        return 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the ball and its room's row, the lock, the key and its row, agent and doors."""
        return (3,), (), (2,), (), self.grid.walls

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        ball, lock, key, agent, doors = draws
        rows = self.grid.rows
        for row in range(1, rows):
            layout = self.grid.remove_wall(layout, (1, row), UP)
        locked_room, color = (2, choose(ball[0], rows)), random_color(lock)
        layout, _ = self.grid.add_door(layout, locked_room, LEFT, color, True)
        code = packed(tiles.BALL, random_color(ball[1]))
        layout, _ = self.grid.place(layout, locked_room, code, ball[2])
        key_room = (0, choose(key[0], rows))
        layout, _ = self.grid.place(layout, key_room, packed(tiles.KEY, color), key[1])
        layout = self.grid.place_agent(layout, (1, rows // 2), agent)
        layout = self.grid.connect_all(layout, doors)
        return layout, clause(PICK_UP, describe(tiles.BALL))
