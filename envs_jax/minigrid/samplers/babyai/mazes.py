"""Levels in a maze of rooms with shut doors: go to something, pick it up, open a door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import GO_TO, OPEN, PICK_UP
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.babyai.level import LevelSampler, Shape, choose, clause, like
from envs_jax.minigrid.samplers.room_grid import Layout
from envs_jax.minigrid.sentences import DOOR, Sentence, kind_of

_VERBS = {"go to": GO_TO, "pick up": PICK_UP, "open": OPEN}


@dataclass(frozen=True)
class MazeSampler(LevelSampler):
    """Rooms that doors connect, with objects anywhere; one of them, or a door, is asked for.

    Attributes:
      verb: what to do; "open" is for doors.
      num_objects: how many random objects there are.
      doors_open: whether all doors stand open at first.
      blocked: whether something must be out of reach, unless objects are moved; else nothing is.

    Source: `GoTo`, `Open`, `Pickup` and `UnblockPickup` of minigrid 3.2.0.
    """

    verb: Literal["go to", "pick up", "open"] = "go to"
    num_objects: int = 18
    doors_open: bool = False
    blocked: bool = False

    @property
    def is_go_to(self) -> bool:
        """Whether all there ever is to do is to go to one object."""
        return self.verb == "go to"

    @property
    def beliefs(self) -> int:
        """How many of the first clauses can be of the kind "go to"."""
        return int(self.is_go_to)

    @property
    def mission_length(self) -> int:
        """Words of "pick up the red ball", or "open the red door"."""
        return 4 if self.verb == "open" else 5

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the agent, doors, objects and what is asked for."""
        return (), self.grid.walls, (self.num_objects, 2), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        agent, doors, objects, choice = draws
        room, agent = self.grid.random_room(agent)
        layout = self.grid.place_agent(layout, room, agent)
        layout = self.grid.connect_all(layout, doors)
        layout, placed = self.grid.add_distractors(layout, objects, unique=False)
        reachable = placement.objects_reachable(layout.plane, layout.agent)
        layout = layout._replace(valid=layout.valid & (reachable != self.blocked))
        is_door = kind_of(layout.plane) == DOOR
        if self.verb == "open":
            (x, y), _ = placement.choose_cell(choice, is_door)
            target = layout.plane[x, y]
        else:
            target = placed.codes[choose(choice, self.num_objects)]
        if self.doors_open:
            opened = layout.plane & (255 - tiles.TYPE_MASK) | tiles.OPEN_DOOR
            layout = layout._replace(plane=jnp.where(is_door, opened, layout.plane))
        return layout, clause(_VERBS[self.verb], like(target))
