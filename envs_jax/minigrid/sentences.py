"""What an instruction says, as data: clauses about objects, how they are joined, and their words.

A `Sentence` is what a level's sampler makes up. The program to be followed, the objects it is about
and the mission's tokens all come from it, inside compiled code.

Source: `verifier` of minigrid 3.2.0, in particular its methods `surface` and `find_matching_objs`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import DOORS, is_kind
from envs_jax.minigrid.instructions import (
    AFTER,
    GO_TO,
    MAX_CLAUSES,
    NOTHING,
    OPEN,
    PICK_UP,
    PUT_NEXT,
    THEN,
    Program,
)
from envs_jax.minigrid.missions import COLOR_TOKENS, KIND_TOKENS, PAD, word_tokens

# What a description may leave open: the type, the colour, where the object is.
ANY_KIND, ANY_COLOR, ANYWHERE = tiles.UNSEEN, -1, 0
ON_THE_LEFT, ON_THE_RIGHT, IN_FRONT, BEHIND = range(1, 5)
DOOR = tiles.OPEN_DOOR

# Quarter turns to the right, from where the agent looks to where these are.
_TURNS = (0, 3, 1, 0, 2)
# The headings that cut off the first x, the last x, the first y and the last y of a room.
_CUT_ON = (0, 2, 1, 3)
_EVERYWHERE = (0, 2**30, 0, 2**30)
_PLACES = ("", "on your left", "on your right", "in front of you", "behind you")
_VERBS = {NOTHING: "", GO_TO: "go to", OPEN: "open", PICK_UP: "pick up", PUT_NEXT: "put"}
_JOINTS = ("", "and", ", then", "after you")


def _table(phrases: tuple[str, ...]) -> np.ndarray:
    """Returns the phrases' tokens int32[phrases, words], padded."""
    rows = [word_tokens(phrase) for phrase in phrases]
    width = max(len(row) for row in rows)
    return np.array([row + [PAD] * (width - len(row)) for row in rows], np.int32)


_PLACE_TOKENS = _table(_PLACES)
_VERB_TOKENS = _table(tuple(_VERBS[verb] for verb in range(len(_VERBS))))
_JOINT_TOKENS = _table(_JOINTS)
_NEXT_TO_TOKENS = np.array(word_tokens("next to"), np.int32)
_THE, _A, _OBJECT = word_tokens("the a object")


class Description(NamedTuple):
    """A description of objects, or a stack of them; int32 each.

    Attributes:
      kind: a tile type, `DOOR` for doors in any state, or `ANY_KIND`.
      color: a colour or `ANY_COLOR`.
      location: where the objects are, seen from the agent's first pose in the same room: one of
        `ON_THE_LEFT`, `ON_THE_RIGHT`, `IN_FRONT`, `BEHIND`; or `ANYWHERE`.
    """

    kind: jax.Array
    color: jax.Array
    location: jax.Array

    def fits(self, codes: jax.Array, x: jax.Array, y: jax.Array, places: jax.Array) -> jax.Array:
        """Returns bool[...], of which objects it is true.

        Args:
          codes: uint8[...] packed tiles.
          x: int32[...], where they are.
          y: int32[...]; both can be broadcast to `codes`.
          places: int32[5, 4], see `located`.
        """
        kinds = kind_of(codes)
        fits = (kinds == self.kind) | ((self.kind == ANY_KIND) & (kinds != tiles.EMPTY))
        fits &= (color_of(codes) == self.color) | (self.color == ANY_COLOR)
        numbers = jnp.arange(len(_PLACES), dtype=jnp.int32)[:, None]
        # A sum rather than a look-up: XLA would repeat that for each object.
        place = jnp.sum(jnp.where(numbers == self.location, places, 0), axis=0, dtype=jnp.int32)
        return fits & inside(place, x, y)


def kind_of(code: jax.Array) -> jax.Array:
    """Returns the int32 types of packed tiles, `DOOR` for doors in any state."""
    return jnp.where(is_kind(code, DOORS), DOOR, (code & tiles.TYPE_MASK).astype(jnp.int32))


def color_of(code: jax.Array) -> jax.Array:
    """Returns the int32 colours of packed tiles."""
    return (code >> tiles.COLOR_SHIFT).astype(jnp.int32)


def located(position: jax.Array, direction: jax.Array, room_size: int) -> jax.Array:
    """Returns int32[5, 4], the first and the last x and y of each location; see `Description`.

    Args:
      position: int32[2], the agent's.
      direction: int32 scalar, the agent's.
      room_size: edge of the rooms, walls included.
    """
    pitch = room_size - 1
    left, top = position[0] // pitch * pitch, position[1] // pitch * pitch
    room = jnp.stack([left, left + pitch, top, top + pitch])
    # The room cut off beside the agent: all but what is to the right of it, below, …
    cut = jnp.stack([position[0] + 1, position[0] - 1, position[1] + 1, position[1] - 1])
    sides = (direction + jnp.array(_TURNS, jnp.int32)) % 4
    limits = jnp.where(sides[:, None] == jnp.array(_CUT_ON, jnp.int32), cut, room)
    anywhere = jnp.arange(len(_PLACES), dtype=jnp.int32)[:, None] == ANYWHERE
    return jnp.where(anywhere, jnp.array(_EVERYWHERE, jnp.int32), limits)


def inside(place: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """Returns bool[...], which cells (x, y) a rectangle int32[4] contains; see `located`."""
    return (x >= place[0]) & (x <= place[1]) & ((y >= place[2]) & (y <= place[3]))


class Sentence(NamedTuple):
    """Up to four clauses, as the mission names them one after the other.

    Attributes:
      verbs: int32[n], what each clause demands: `NOTHING`, `GO_TO`, `OPEN`, `PICK_UP`, `PUT_NEXT`.
      things: descriptions int32[n] of what to open, pick up or put.
      places: descriptions int32[n] of what to go to or to put something next to.
      joints: int32[n], how each clause is joined to the one before: `ALONE`, `AND`, `THEN` or
        `AFTER`. At most one is `THEN` or `AFTER`.
      strict: bool[n].
    """

    verbs: jax.Array
    things: Description
    places: Description
    joints: jax.Array
    strict: jax.Array

    def program(self) -> Program:
        """Returns what there is to do, and when."""
        present = self.verbs != NOTHING
        second = jnp.cumsum(self.joints >= THEN, dtype=jnp.int32) > 0
        later = jnp.where(jnp.any(self.joints == AFTER), ~second, second)
        return Program(
            go_to=_set(self.verbs == GO_TO),
            open=_set(self.verbs == OPEN),
            pick_up=_set(self.verbs == PICK_UP),
            put_next=_set(self.verbs == PUT_NEXT),
            strict=_set(self.strict & present),
            later=_set(later & present),
        )

    def errands(self) -> jax.Array:
        """Returns how many ways there are to go, int32: two to put something somewhere, else one.

        BabyAI measures the time that an instruction is given by them.
        """
        ways = jnp.where(self.verbs == PUT_NEXT, 2, jnp.where(self.verbs == NOTHING, 0, 1))
        return jnp.sum(ways, dtype=jnp.int32)

    def marks(self, things: jax.Array, places: jax.Array, height: int) -> jax.Array:
        """Returns the marks uint16[width, height] of what the clauses are about.

        Args:
          things: uint32[n, width], where objects are that fit `things`, bit y for cell y.
          places: the same for `places`.
          height: cells of the grid along y.
        """
        handles = (self.verbs == OPEN) | (self.verbs == PICK_UP) | (self.verbs == PUT_NEXT)
        goes = (self.verbs == GO_TO) | (self.verbs == PUT_NEXT)
        y = jnp.arange(height, dtype=jnp.uint32)
        marks = jnp.zeros((things.shape[1], height), jnp.uint32)
        for clause in range(len(self.verbs)):
            place = jnp.where(goes[clause], places[clause], jnp.uint32(0))
            thing = jnp.where(handles[clause], things[clause], jnp.uint32(0))
            marks |= (place[:, None] >> y & 1) << clause
            marks |= (thing[:, None] >> y & 1) << clause + MAX_CLAUSES
        return marks.astype(jnp.uint16)

    def mission(self, things: jax.Array, places: jax.Array, length: int) -> jax.Array:
        """Returns the mission's tokens int32[length], padded at the end.

        Args:
          things: bool[n], whether several objects fit `things` ("a" instead of "the").
          places: the same for `places`.
          length: words that the longest mission of the level needs.
        """
        goes = self.verbs == GO_TO
        chosen = [
            jnp.where(goes, place, thing)
            for place, thing in zip(self.places, self.things, strict=True)
        ]
        objects = _phrase(Description(*chosen), jnp.where(goes, places, things))
        beside = jnp.broadcast_to(_NEXT_TO_TOKENS, (len(self.verbs), len(_NEXT_TO_TOKENS)))
        beside = jnp.concatenate([beside, _phrase(self.places, places)], axis=1)
        puts, said = self.verbs == PUT_NEXT, self.verbs != NOTHING
        pieces = [
            jnp.asarray(_JOINT_TOKENS)[self.joints],
            jnp.asarray(_VERB_TOKENS)[self.verbs],
            jnp.where(said[:, None], objects, PAD),
            jnp.where(puts[:, None], beside, PAD),
        ]
        words = jnp.concatenate(pieces, axis=1).reshape(-1)
        spoken = words != PAD
        place = jnp.cumsum(spoken, dtype=jnp.int32) - 1
        silence = jnp.full(length, PAD, jnp.int32)
        return silence.at[jnp.where(spoken, place, length)].set(words, mode="drop")


def _set(clauses: jax.Array) -> jax.Array:
    """Returns bool[n] as bits of a uint32."""
    bits = jnp.uint32(1) << jnp.arange(len(clauses), dtype=jnp.uint32)
    return jnp.sum(jnp.where(clauses, bits, jnp.uint32(0)), dtype=jnp.uint32)


def _phrase(what: Description, several: jax.Array) -> jax.Array:
    """Returns tokens int32[n, 7], among them `PAD` for words that are not said."""
    article = jnp.where(several, jnp.int32(_A), jnp.int32(_THE))
    color = jnp.where(what.color == ANY_COLOR, PAD, jnp.asarray(COLOR_TOKENS)[what.color])
    kind = jnp.where(what.kind == ANY_KIND, _OBJECT, jnp.asarray(KIND_TOKENS)[what.kind])
    words = jnp.stack([article, color, kind], axis=1)
    return jnp.concatenate([words, jnp.asarray(_PLACE_TOKENS)[what.location]], axis=1)
