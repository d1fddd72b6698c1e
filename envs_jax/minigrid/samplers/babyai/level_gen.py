"""BabyAI's level generator: a maze, perhaps with a locked room, and any instruction about it."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import (
    AFTER,
    ALONE,
    AND,
    GO_TO,
    MAX_CLAUSES,
    OPEN,
    PICK_UP,
    PUT_NEXT,
    THEN,
)
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.babyai.level import (
    LevelSampler,
    Shape,
    choose,
    describe,
    leave_out,
    put_next_is_possible,
    random_color,
)
from envs_jax.minigrid.samplers.room_grid import Layout, Room, packed
from envs_jax.minigrid.sentences import (
    ANY_COLOR,
    DOOR,
    Description,
    Sentence,
    color_of,
    inside,
    kind_of,
    located,
)

# What can be described: the first three types can be carried.
_KINDS = (tiles.KEY, tiles.BALL, tiles.BOX, DOOR)
_COLORS = (ANY_COLOR, *range(tiles.NUM_COLORS))
_LOCATIONS = 5
# MiniGrid gives up when no description out of so many fits anything.
_TRIES = 101


@dataclass(frozen=True)
class LevelGenSampler(LevelSampler):
    """Rooms that doors connect, objects anywhere, and a random instruction.

    Attributes:
      num_objects: how many random objects there are.
      verbs: the verbs of the instruction's clauses, equally likely.
      locked_room: the probability of a room behind a locked door, with the key elsewhere.
      locations: whether descriptions can say where an object is.
      unblocking: whether objects may be out of reach until others are moved. Then no description is
        of a key that a lock needs.
      implicit_unlock: whether all that a description fits may lie in the locked room.
      sequences: whether there can be several clauses; else there is one.

    Source: `LevelGen` of minigrid 3.2.0.
    """

    num_objects: int = 18
    verbs: tuple[int, ...] = (GO_TO, PICK_UP, OPEN, PUT_NEXT)
    locked_room: float = 0.5
    locations: bool = True
    unblocking: bool = True
    implicit_unlock: bool = True
    sequences: bool = True

    @property
    def beliefs(self) -> int:
        """How many of the first clauses can be of the kind "go to"."""
        return self._clauses if GO_TO in self.verbs else 0

    @property
    def mission_length(self) -> int:
        """Words of the longest mission, commas included."""
        described = 7 if self.locations else 3
        words = {GO_TO: 2, PICK_UP: 2, OPEN: 1, PUT_NEXT: 3 + described}
        longest = described + max(words[verb] for verb in self.verbs)
        # Twice "and", and once "after you" or ", then".
        return 4 * longest + 4 if self.sequences else longest

    @property
    def _clauses(self) -> int:
        return MAX_CLAUSES if self.sequences else 1

    @property
    def draw_shapes(self) -> tuple[Shape, ...]:
        """Draws for lock and key, doors, objects, agent, clauses, descriptions, and their order."""
        descriptions = (2, self._clauses, 2)
        return (
            (6,),
            self.grid.walls,
            (self.num_objects, 2),
            (),
            (self._clauses,),
            descriptions,
            (4,),
        )

    def furnish(self, layout: Layout, *draws: jax.Array) -> tuple[Layout, Sentence]:
        """Returns a level and its instruction; see `LevelSampler.furnish`."""
        lock, doors, objects, agent, verbs, descriptions, order = draws
        grid = self.grid
        is_locked, locked, key = jnp.bool_(False), (jnp.int32(0), jnp.int32(0)), None
        if self.locked_room > 0:
            is_locked = lock[0] < self.locked_room
            closed, locked, key = self._lock(layout, lock[1:])
            layout = jax.tree.map(lambda *two: jnp.where(is_locked, *two), closed, layout)
        layout = grid.connect_all(layout, doors)
        layout, placed = grid.add_distractors(layout, objects, unique=False)
        layout = grid.place_agent(layout, *self._agent_room(is_locked, locked, agent))
        valid = layout.valid
        if not self.unblocking:
            valid &= placement.objects_reachable(layout.plane, layout.agent)

        doors = grid.door_cells(layout).reshape(-1, 2)
        groups = [
            (placed.codes, placed.cells, jnp.ones(self.num_objects, bool)),
            (layout.plane[doors[:, 0], doors[:, 1]], doors, layout.joined.reshape(-1)),
        ]
        if key is not None:
            groups.append((key[0][None], key[1][None], is_locked[None]))
        codes, cells, here = (jnp.concatenate(parts) for parts in zip(*groups, strict=True))
        if self.locked_room > 0 and not self.implicit_unlock:
            here &= ~(grid.in_room(locked)[cells[:, 0], cells[:, 1]] & is_locked)
        fits = self._fits(layout, codes, cells, here)
        sentence, found = self._sentence(fits, verbs, descriptions, order)
        valid &= found
        if PUT_NEXT in self.verbs:
            valid &= put_next_is_possible(grid, layout, sentence)
        if self.unblocking and key is not None:
            valid &= ~(is_locked & _speaks_of_key(sentence, color_of(key[0])))
        return layout._replace(valid=valid), sentence

    def _lock(
        self, layout: Layout, draws: jax.Array
    ) -> tuple[Layout, Room, tuple[jax.Array, jax.Array]]:
        """Locks a room, and puts the key into another.

        Returns the layout, the room, and the key's tile and cell.

        Args:
          layout: rooms without doors.
          draws: float32[5].
        """
        grid = self.grid
        # Every side with a neighbour is as likely as any other: rooms have two to four of them.
        sides = np.zeros((grid.columns * grid.rows, 4), bool)
        for number in range(len(sides)):
            column, row = divmod(number, grid.rows)
            sides[number] = [column < grid.columns - 1, row < grid.rows - 1, column > 0, row > 0]
        (number, side), _ = placement.choose_cell(draws[0], jnp.asarray(sides))
        room = (number // grid.rows, number % grid.rows)
        color = random_color(draws[1])
        layout, _ = grid.add_door(layout, room, side, color, True)
        other = choose(draws[2], grid.columns * grid.rows - 1)
        other += (other >= number).astype(jnp.int32)
        code = packed(tiles.KEY, color)
        layout, cell = grid.place(layout, (other // grid.rows, other % grid.rows), code, draws[3])
        return layout, room, (code, cell)

    def _agent_room(
        self, is_locked: jax.Array, locked: Room, draw: jax.Array
    ) -> tuple[Room, jax.Array]:
        """Returns a uniform room that is not locked, and what is left of the draw."""
        rooms = self.grid.columns * self.grid.rows
        number, rest = placement.split_draw(draw, rooms - is_locked.astype(jnp.int32))
        shut = locked[0] * self.grid.rows + locked[1]
        number += (is_locked & (number >= shut)).astype(jnp.int32)
        return (number // self.grid.rows, number % self.grid.rows), rest

    def _fits(
        self, layout: Layout, codes: jax.Array, cells: jax.Array, here: jax.Array
    ) -> jax.Array:
        """Returns which descriptions fit anything, bool[kinds, colours, locations].

        Args:
          layout: the level.
          codes: tiles uint8[n] that descriptions may be of.
          cells: int32[n, 2], where they are.
          here: bool[n], which of them count.
        """
        places = located(layout.agent, layout.direction, self.grid.room_size)
        kinds = jnp.array(_KINDS, jnp.int32)[:, None, None]
        there = inside(places.T[..., None], cells[:, 0], cells[:, 1])
        found = (kind_of(codes) == kinds) & there & here
        color = jnp.uint32(1) << color_of(codes).astype(jnp.uint32)
        present = jax.lax.reduce_or(jnp.where(found, color, jnp.uint32(0)), axes=(2,))
        # Sets of colours are bits; the first of `_COLORS` stands for all.
        wanted = np.array([2**tiles.NUM_COLORS - 1, *(2**n for n in range(tiles.NUM_COLORS))])
        return present[:, None] & wanted.astype(np.uint32)[:, None] != 0

    @property
    def _shares(self) -> tuple[int, ...]:
        """How likely the locations are: half of the descriptions have none."""
        return (4, 1, 1, 1, 1) if self.locations else (1, 0, 0, 0, 0)

    def _describe(
        self, weights: jax.Array, kinds: jax.Array, draws: jax.Array
    ) -> tuple[Description, jax.Array]:
        """Returns a random description that fits something, and whether MiniGrid would find one.

        Args:
          weights: int32[kinds, colours, locations], how likely those are that fit something.
          kinds: bool[kinds], the types that may be described.
          draws: float32[2].
        """
        # One part after the other: a running sum over all of the table would be slow.
        by_color = jnp.sum(weights, axis=2, dtype=jnp.int32)
        by_kind = jnp.where(kinds, jnp.sum(by_color, axis=1, dtype=jnp.int32), 0)
        total = jnp.sum(by_kind, dtype=jnp.int32)
        rank = placement.uniform_int(draws[0], 0, total)
        kind, rank = placement.choose_ranked(rank, by_kind)
        color, rank = placement.choose_ranked(rank, by_color[kind])
        location, _ = placement.choose_ranked(rank, weights[kind, color])
        numbers = jnp.arange(len(_KINDS), dtype=jnp.int32)
        what = describe(
            jnp.sum(jnp.where(numbers == kind, jnp.array(_KINDS, jnp.int32), 0), dtype=jnp.int32),
            color + ANY_COLOR,
            location,
        )
        every = jnp.sum(kinds, dtype=jnp.int32) * (len(_COLORS) * sum(self._shares))
        hopeless = 1 - total.astype(jnp.float32) / every.astype(jnp.float32)
        return what, draws[1] >= hopeless**_TRIES

    def _sentence(
        self, fits: jax.Array, verbs: jax.Array, descriptions: jax.Array, order: jax.Array
    ) -> tuple[Sentence, jax.Array]:
        """Returns a random instruction, and whether MiniGrid would find objects for all of it."""
        choice = jnp.array(self.verbs, jnp.int32)[choose(verbs, len(self.verbs))]
        is_door = jnp.array([kind == DOOR for kind in _KINDS])[None]
        opens = (choice == OPEN)[:, None]
        anything = jnp.ones_like(is_door)
        handled = jnp.where(choice[:, None] == GO_TO, anything, jnp.where(opens, is_door, ~is_door))
        weights = jnp.where(fits, jnp.array(self._shares, jnp.int32)[None, None], 0)
        kinds = jnp.stack([handled, jnp.broadcast_to(anything, handled.shape)])
        random = jax.vmap(jax.vmap(self._describe, in_axes=(None, 0, 0)), in_axes=(None, 0, 0))
        found, known = random(weights, kinds, descriptions)
        things, places = (Description(*(part[which] for part in found)) for which in range(2))
        known = known[0] & (known[1] | (choice != PUT_NEXT))

        puts = choice == PUT_NEXT
        places = jax.tree.map(lambda *two: jnp.where(puts, *two), places, things)
        count = len(choice)
        joints, said = jnp.full(count, ALONE, jnp.int32), jnp.ones(count, bool)
        if self.sequences:
            shape = choose(order[0], 3)  # One action, two at once, or one after the other.
            doubles = order[1:3] < 0.5
            joint = jnp.where(order[3] < 0.5, THEN, AFTER)
            joints = jnp.array([ALONE, AND, 0, AND], jnp.int32).at[2].set(joint)
            in_turn = shape == 2
            first_double = (shape == 1) | (in_turn & doubles[0])
            said = jnp.stack([jnp.bool_(True), first_double, in_turn, in_turn & doubles[1]])
        sentence = Sentence(choice, things, places, joints, jnp.zeros(count, bool))
        return leave_out(said, sentence), jnp.all(known | ~said)


def _speaks_of_key(sentence: Sentence, color: jax.Array) -> jax.Array:
    """Returns a bool: some clause is about keys of that very colour."""

    def is_key(what: Description) -> jax.Array:
        return (what.kind == tiles.KEY) & (what.color == color)

    return jnp.any((is_key(sentence.things) | is_key(sentence.places)) & (sentence.verbs != 0))
