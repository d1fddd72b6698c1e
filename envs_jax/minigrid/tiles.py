"""Cells of a grid world, packed into one byte: type in the low four bits, colour in the next three.

Types and colours carry MiniGrid's own numbers (`minigrid.core.constants`), except that a door's
state is folded into its type: an open door is 4, a closed one 11, a locked one 12, and one that
stands open although its lock was never turned 13 (no generator makes it; code that opens a
door by hand can). MiniGrid's (type, colour, state) triple is recovered by `decode`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

UNSEEN, EMPTY, WALL, FLOOR, OPEN_DOOR, KEY, BALL, BOX, GOAL, LAVA, AGENT = range(11)
CLOSED_DOOR, LOCKED_DOOR, OPEN_LOCKED_DOOR = 11, 12, 13
NUM_TYPES = 14

RED, GREEN, BLUE, PURPLE, YELLOW, GREY = range(6)
NUM_COLORS = 6
# MiniGrid's COLOR_NAMES order, in which its generators enumerate colours: sorted by name.
SORTED_COLORS = (BLUE, GREEN, GREY, PURPLE, RED, YELLOW)

TYPE_MASK = 15
COLOR_SHIFT = 4


def tile(kind: int, color: int = RED) -> int:
    """Returns the packed code of a static (type, colour) pair."""
    return kind | color << COLOR_SHIFT


EMPTY_TILE = tile(EMPTY)
WALL_TILE = tile(WALL, GREY)
GOAL_TILE = tile(GOAL, GREEN)
LAVA_TILE = tile(LAVA)

# Row `code` holds MiniGrid's (type, colour, state).
_codes = np.arange(256)
_types = _codes & TYPE_MASK
ENCODING = np.stack(
    [
        np.where((_types >= CLOSED_DOOR) & (_types <= OPEN_LOCKED_DOOR), OPEN_DOOR, _types),
        _codes >> COLOR_SHIFT,
        np.select([_types == CLOSED_DOOR, _types == LOCKED_DOOR], [1, 2], 0),
    ],
    axis=-1,
).astype(np.uint8)


def decode(codes: jax.Array) -> jax.Array:
    """Turns packed codes uint8[...] into MiniGrid's encoding uint8[..., 3]."""
    return jnp.asarray(ENCODING).at[codes].get(mode="promise_in_bounds")
