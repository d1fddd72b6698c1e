"""What BabyAI's levels share: rooms are furnished, an instruction is made up, an episode begins."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import prod

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import ALONE, NOTHING, PUT_NEXT
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import Int, Layout, RoomGrid
from envs_jax.minigrid.sentences import (
    ANY_COLOR,
    ANY_KIND,
    ANYWHERE,
    Description,
    Sentence,
    color_of,
    kind_of,
    located,
)
from envs_jax.minigrid.tasks import InstructionState
from jaxact.pomdp import Episode, PyTree, TaskSampler

Shape = tuple[int, ...]


@dataclass(frozen=True)
class LevelSampler(TaskSampler):
    """A distribution of BabyAI levels on a grid of rooms.

    Whole levels are drawn until one is valid, as MiniGrid's rejection sampling does.

    Attributes:
      grid: the rooms.
      max_steps: the time of an episode; with None it depends on the instruction: as many steps as
        the grid's rooms have cells for each errand.

    Source: `RoomGridLevel` of minigrid 3.2.0.
    """

    grid: RoomGrid
    max_steps: int | None = None

    @property
    def beliefs(self) -> int:
        """How many of the first clauses can be of the kind "go to"."""
        return 0

    @property
    def is_go_to(self) -> bool:
        """Whether all there ever is to do is to go to one object, a `GoToTask`."""
        return False

    @property
    @abstractmethod
    def mission_length(self) -> int:
        """Words of the longest mission, commas included."""

    @property
    @abstractmethod
    def draw_shapes(self) -> tuple[Shape, ...]:
        """The shapes of the uniform draws that `furnish` takes."""

    @abstractmethod
    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level made of bare rooms, perhaps not a valid one, and its instruction.

        Args:
          layout: rooms without doors.
          *draws: uniform float32 in [0, 1) of `draw_shapes`, the only randomness.
        """

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        layout, sentence = placement.until_valid(key, self.num_draws, self.draw)
        return self.begin(layout, sentence)

    @property
    def num_draws(self) -> int:
        """How many draws a level takes."""
        return sum(map(prod, self._shapes))

    def draw(self, draws: jax.Array) -> tuple[tuple[Layout, Sentence], jax.Array]:
        """Makes one level of float32[num_draws] in [0, 1); returns it and whether it is valid."""
        parts, end = [], 0
        for shape in self._shapes:
            parts.append(draws[end : end + prod(shape)].reshape(shape))
            end += prod(shape)
        walls, *rest = parts
        layout, sentence = self.furnish(self.grid.closed(walls), *rest)
        return (layout, sentence), layout.valid

    @property
    def _shapes(self) -> tuple[Shape, ...]:
        """Shapes of all draws: for the walls' doors, and those of `furnish`."""
        return (self.grid.walls, *self.draw_shapes)

    def begin(self, layout: Layout, sentence: Sentence) -> Episode:
        """Returns the episode of a valid level."""
        things, places = matches(self.grid, layout, sentence)
        several_things, several_places = (
            jnp.sum(placement.bit_counts(cells), axis=1, dtype=jnp.int32) > 1
            for cells in (things, places)
        )
        layout = layout._replace(
            marks=layout.marks | sentence.marks(things, places, self.grid.height)
        )
        if self.max_steps is None:
            area = self.grid.room_size**2 * self.grid.columns * self.grid.rows
            horizon = area * sentence.errands()
        else:
            horizon = jnp.int32(self.max_steps)
        task = InstructionState(
            steps=jnp.int32(0),
            max_steps=horizon,
            mission=sentence.mission(several_things, several_places, self.mission_length),
            program=sentence.program().pack(),
            progress=jnp.uint8(0),
            ghosts=jnp.zeros((self.beliefs, self.grid.height), jnp.uint32),
        )
        if self.is_go_to:
            task = replace(task, program=None, progress=None)
        return Episode(layout.state(), task, horizon)


def matches(grid: RoomGrid, layout: Layout, sentence: Sentence) -> tuple[jax.Array, jax.Array]:
    """Returns where the things and the places of n clauses are, packed into uint32[n, width]."""
    x = jnp.arange(grid.width, dtype=jnp.int32)[:, None]
    y = jnp.arange(grid.height, dtype=jnp.int32)
    places = located(layout.agent, layout.direction, grid.room_size)

    def find(what: Description) -> jax.Array:
        return placement.packed_rows(what.fits(layout.plane, x, y, places))

    return jax.vmap(find)(sentence.things), jax.vmap(find)(sentence.places)


def describe(kind: Int = ANY_KIND, color: Int = ANY_COLOR, location: Int = ANYWHERE) -> Description:
    """Returns a description; each part may be static or computed."""
    return Description(*(jnp.asarray(part, jnp.int32) for part in (kind, color, location)))


def like(code: jax.Array) -> Description:
    """Returns the description of objects, by type and colour, that look like a packed tile."""
    return describe(kind_of(code), color_of(code))


def clause(
    verb: Int,
    what: Description,
    place: Description | None = None,
    joint: Int = ALONE,
    strict: bool = False,
) -> Sentence:
    """Returns a sentence of one clause, to stand alone or to be joined to others.

    Args:
      verb: what to do; see `instructions`.
      what: with what: what to go to, to open, to pick up or to put somewhere.
      place: what to put it next to.
      joint: how the clause is joined to the one before.
      strict: whether a wrong object makes it fail.
    """
    things = Description(*(part[None] for part in what))
    places = things if place is None else Description(*(part[None] for part in place))
    verb, joint = jnp.asarray(verb, jnp.int32), jnp.asarray(joint, jnp.int32)
    return Sentence(verb[None], things, places, joint[None], jnp.full(1, strict))


def join(*clauses: Sentence) -> Sentence:
    """Returns the clauses as one sentence."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *clauses)


def leave_out(said: jax.Array, clauses: Sentence) -> Sentence:
    """Returns a sentence with gaps for the clauses, bool or bool[n], that are not to be `said`."""
    return clauses._replace(
        verbs=jnp.where(said, clauses.verbs, NOTHING),
        joints=jnp.where(said, clauses.joints, ALONE),
    )


def put_next_is_possible(grid: RoomGrid, layout: Layout, sentence: Sentence) -> jax.Array:
    """Returns a bool: in no clause that puts, a thing is a place or stands beside one already.

    Source: `RoomGridLevel.validate_instrs` of minigrid 3.2.0.
    """
    things, places = matches(grid, layout, sentence)
    clash = jnp.any(things & jax.vmap(placement.spread)(places) != 0, axis=1)
    return ~jnp.any(clash & (sentence.verbs == PUT_NEXT))


def choose(draw: jax.Array, count: int) -> jax.Array:
    """Returns a uniform int32 below `count`."""
    return placement.uniform_int(draw, 0, count)


def random_color(draw: jax.Array) -> jax.Array:
    """Returns a uniform colour, int32."""
    return choose(draw, tiles.NUM_COLORS)
