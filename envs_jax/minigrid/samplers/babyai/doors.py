"""Levels with doors round the agent's room: go to them, open one of them, or two in order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import AFTER, GO_TO, OPEN, PICK_UP, THEN
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.babyai.level import (
    LevelSampler,
    Shape,
    choose,
    clause,
    describe,
    join,
    leave_out,
    like,
    random_color,
)
from envs_jax.minigrid.samplers.room_grid import LEFT, RIGHT, Layout, packed
from envs_jax.minigrid.sentences import ANY_COLOR, ANYWHERE, DOOR, ON_THE_LEFT, Sentence

_MIDDLE = (1, 1)
_SIDES = 4


@dataclass(frozen=True)
class RoundDoorsSampler(LevelSampler):
    """A room with a door in each of its walls, and objects; go to one of them all.

    Attributes:
      num_objects: how many objects there are.
      kind: which of three levels it is. In "doors" there are no objects; in "objects" they come
        after the agent, and can all be reached. In "actions" no two are alike and no door is
        locked; instead of going to a thing, it may have to be opened or picked up.

    Source: `GoToDoor`, `GoToObjDoor` and `ActionObjDoor` of minigrid 3.2.0.
    """

    kind: Literal["doors", "objects", "actions"] = "doors"
    num_objects: int = 0

    @property
    def is_go_to(self) -> bool:
        """Whether all there ever is to do is to go to one object."""
        return self.kind != "actions"

    @property
    def beliefs(self) -> int:
        """How many of the first clauses can be of the kind "go to"."""
        return 1

    @property
    def mission_length(self) -> int:
        """Words of "go to the red ball"."""
        return 5

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the agent, objects, doors' colours and locks, what is asked for, and how."""
        return (), (self.num_objects, 2), (_SIDES, 2), (), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        agent, objects, doors, choice, verb = draws
        if self.kind == "objects":
            layout = self.grid.place_agent(layout, _MIDDLE, agent)
        codes = jnp.zeros(0, jnp.uint8)
        if self.num_objects > 0:
            layout, placed = self.grid.add_distractors(
                layout, objects, _MIDDLE, unique=self.kind == "actions"
            )
            codes = placed.codes
        colors = random_color(doors[:, 0])
        locked = (doors[:, 1] < 0.5) & (self.kind != "actions")
        for side in range(_SIDES):
            layout, _ = self.grid.add_door(layout, _MIDDLE, side, colors[side], locked[side])
        if self.kind != "objects":
            layout = self.grid.place_agent(layout, _MIDDLE, agent)
        else:
            reachable = placement.objects_reachable(layout.plane, layout.agent)
            layout = layout._replace(valid=layout.valid & reachable)
        codes = jnp.concatenate([codes, packed(DOOR, colors)])
        chosen = choose(choice, len(codes))
        other = jnp.where(chosen < self.num_objects, PICK_UP, OPEN)
        acts = (verb < 0.5) & (self.kind == "actions")
        return layout, clause(jnp.where(acts, other, GO_TO), like(codes[chosen]))


@dataclass(frozen=True)
class OpenDoorSampler(LevelSampler):
    """A room with doors of four colours; open one, known by its colour or by where it is.

    The door known by its colour is always the one on the right side of the room.

    Attributes:
      select_by: how the door is known; None for either.
      strict: whether to open another door is to fail.

    Source: `OpenDoor` of minigrid 3.2.0.
    """

    select_by: Literal["color", "location"] | None = None
    strict: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "open the red door", or "open the door in front of you"."""
        return 4 if self.select_by == "color" else 7

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the doors' colours, how the door is known, where it is, and the agent."""
        return (tiles.NUM_COLORS,), (), (), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        colors, kind, location, agent = placement.order(draws[0]), *draws[1:]
        for side in range(_SIDES):
            layout, _ = self.grid.add_door(layout, _MIDDLE, side, colors[side], False)
        by_color = kind < 0.5 if self.select_by is None else jnp.bool_(self.select_by == "color")
        layout = self.grid.place_agent(layout, _MIDDLE, agent)
        door = describe(
            DOOR,
            jnp.where(by_color, colors[0], ANY_COLOR),
            jnp.where(by_color, ANYWHERE, ON_THE_LEFT + choose(location, 4)),
        )
        return layout, clause(OPEN, door, strict=self.strict)


@dataclass(frozen=True)
class OpenTwoDoorsSampler(LevelSampler):
    """A room with a door on its left and one on its right; open them in this order.

    Attributes:
      colors: the doors' colours, left and right; None for two random ones.
      strict: whether to open the right door first is to fail.

    Source: `OpenTwoDoors` of minigrid 3.2.0.
    """

    colors: tuple[int, int] | None = None
    strict: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "open the red door, then open the blue door"."""
        return 10

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the colours and the agent."""
        return (tiles.NUM_COLORS,), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        colors = (
            placement.order(draws[0]) if self.colors is None else jnp.array(self.colors, jnp.int32)
        )
        layout, _ = self.grid.add_door(layout, _MIDDLE, LEFT, colors[0], False)
        layout, _ = self.grid.add_door(layout, _MIDDLE, RIGHT, colors[1], False)
        layout = self.grid.place_agent(layout, _MIDDLE, draws[1])
        return layout, join(
            clause(OPEN, describe(DOOR, colors[0]), strict=self.strict),
            clause(OPEN, describe(DOOR, colors[1]), joint=THEN),
        )


@dataclass(frozen=True)
class OpenDoorsInOrderSampler(LevelSampler):
    """A room with doors of different colours; open one, or one before, or after, another.

    Attributes:
      num_doors: how many doors there are, 2 to 4.
      strict: whether to open any other door is to fail. The step that opens the first door of two
        then fails at the second: only instructions about one door can be followed.

    Source: `OpenDoorsOrder` of minigrid 3.2.0.
    """

    num_doors: int = 2
    strict: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "open the red door after you open the blue door"."""
        return 10

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for colours, sides, the agent, which doors, and how many in which order."""
        return (tiles.NUM_COLORS,), (_SIDES,), (), (self.num_doors,), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        colors, sides, chosen = (
            placement.order(draws[0]),
            placement.order(draws[1]),
            placement.order(draws[3]),
        )
        for door in range(self.num_doors):
            layout, _ = self.grid.add_door(layout, _MIDDLE, sides[door], colors[door], False)
        layout = self.grid.place_agent(layout, _MIDDLE, draws[2])
        mode = choose(draws[4], 3)
        first, second = (describe(DOOR, colors[chosen[place]]) for place in (0, 1))
        joint = jnp.where(mode == 1, THEN, AFTER)
        return layout, join(
            clause(OPEN, first, strict=self.strict),
            leave_out(mode != 0, clause(OPEN, second, joint=joint, strict=self.strict)),
        )


@dataclass(frozen=True)
class OpenRedDoorSampler(LevelSampler):
    """Two rooms and the red door between them, to be opened.

    Source: `OpenRedDoor` of minigrid 3.2.0.
    """

    @property
    def mission_length(self) -> int:
        """Words of "open the red door"."""
        return 4

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """A draw for the agent."""
        return ((),)

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        layout, _ = self.grid.add_door(layout, (0, 0), RIGHT, tiles.RED, False)
        layout = self.grid.place_agent(layout, (0, 0), draws[0])
        return layout, clause(OPEN, describe(DOOR, tiles.RED))
