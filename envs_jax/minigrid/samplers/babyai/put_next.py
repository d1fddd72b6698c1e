"""Levels with an object to be put next to another, in one room or across two."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid.instructions import PUT_NEXT, THEN
from envs_jax.minigrid.late_hands import LateHandsState
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.babyai.level import (
    LevelSampler,
    Shape,
    choose,
    clause,
    join,
    like,
    matches,
    put_next_is_possible,
)
from envs_jax.minigrid.samplers.room_grid import RIGHT, Layout
from envs_jax.minigrid.sentences import Sentence
from jaxact.pomdp import Episode

_LEFT_ROOM, _RIGHT_ROOM = (0, 0), (1, 0)


@dataclass(frozen=True)
class PutNextLocalSampler(LevelSampler):
    """A room with objects, no two of them alike; one is to be put next to another.

    Source: `PutNextLocal` of minigrid 3.2.0.
    """

    num_objects: int = 8

    @property
    def mission_length(self) -> int:
        """Words of "put the red ball next to the blue key"."""
        return 9

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the agent, the objects, and which of them."""
        return (), (self.num_objects, 2), (self.num_objects,)

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        agent, objects, choice = draws
        layout = self.grid.place_agent(layout, (0, 0), agent)
        layout, placed = self.grid.add_distractors(layout, objects, (0, 0))
        first, second, *_ = placement.order(choice)
        sentence = clause(PUT_NEXT, like(placed.codes[first]), like(placed.codes[second]))
        possible = put_next_is_possible(self.grid, layout, sentence)
        reachable = placement.objects_reachable(layout.plane, layout.agent)
        return layout._replace(valid=layout.valid & reachable & possible), sentence


@dataclass(frozen=True)
class PutNextSampler(LevelSampler):
    """Two rooms made one, with objects on either side; one goes next to one of the other side.

    Attributes:
      objects_a_room: how many objects there are on each side, no two of all alike.
      start_carrying: whether the agent is given the object to move after its first observation.

    Source: `PutNext` of minigrid 3.2.0.
    """

    objects_a_room: int = 1
    start_carrying: bool = False

    @property
    def mission_length(self) -> int:
        """Words of "put the red ball next to the blue key"."""
        return 9

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the agent, the objects on both sides, which of them, and which goes where."""
        return (), (2, self.objects_a_room, 2), (2,), ()

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        agent, objects, choice, swap = draws
        layout = self.grid.place_agent(layout, _LEFT_ROOM, agent)
        layout, left = self.grid.add_distractors(layout, objects[0], _LEFT_ROOM)
        layout, right = self.grid.add_distractors(layout, objects[1], _RIGHT_ROOM)
        layout = self.grid.remove_wall(layout, _LEFT_ROOM, RIGHT)
        one = left.codes[choose(choice[0], self.objects_a_room)]
        other = right.codes[choose(choice[1], self.objects_a_room)]
        moved, fixed = jnp.where(swap < 0.5, other, one), jnp.where(swap < 0.5, one, other)
        return layout, clause(PUT_NEXT, like(moved), like(fixed))

    def begin(self, layout: Layout, sentence: Sentence) -> Episode:
        """Returns the episode of a level; see `LevelSampler.begin`."""
        episode = super().begin(layout, sentence)
        if not self.start_carrying:
            return episode
        things, _ = matches(self.grid, layout, sentence)
        only = placement.ranked_cell(jnp.int32(0), things[0], self.grid.height)
        return replace(episode, environment=LateHandsState.of(episode.environment, only))


@dataclass(frozen=True)
class MoveTwoAcrossSampler(LevelSampler):
    """Two rooms made one, with objects on either side; two of them go across, one after the other.

    Attributes:
      objects_a_room: how many objects there are on each side, no two of all alike.

    Source: `MoveTwoAcross` of minigrid 3.2.0.
    """

    objects_a_room: int = 2

    @property
    def mission_length(self) -> int:
        """Words of twice "put the red ball next to the blue key", and ", then"."""
        return 20

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for the agent, the objects on both sides, and which of them."""
        return (), (2, self.objects_a_room, 2), (2, self.objects_a_room)

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        agent, objects, choice = draws
        layout = self.grid.place_agent(layout, _LEFT_ROOM, agent)
        layout, left = self.grid.add_distractors(layout, objects[0], _LEFT_ROOM)
        layout, right = self.grid.add_distractors(layout, objects[1], _RIGHT_ROOM)
        layout = self.grid.remove_wall(layout, _LEFT_ROOM, RIGHT)
        lefts, rights = (
            left.codes[placement.order(choice[0])],
            right.codes[placement.order(choice[1])],
        )
        return layout, join(
            clause(PUT_NEXT, like(lefts[0]), like(rights[0])),
            clause(PUT_NEXT, like(rights[1]), like(lefts[1]), joint=THEN),
        )
