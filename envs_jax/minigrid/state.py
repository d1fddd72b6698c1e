"""The state of a grid world: one hot plane of packed tiles, one cold plane of marks, one agent."""

from __future__ import annotations

from dataclasses import dataclass

import jax

# Cells of wall round the grid, so that a 7×7 view never leaves the array (off-grid is wall, as in
# MiniGrid).
PADDING = 6

# A mark, uint16 a cell, travels with the object that stands there. Low byte: what the task tracks
# it for; an instruction uses all of these bits (see `instructions`), a rule the lowest (see
# `rules`). Bits 8–10: what a box contains, as a key's colour + 1 (only keys are ever contained),
# 0 when it is empty.
TRACKED_MASK = 255
CONTENTS_SHIFT = 8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridState:
    """A grid world, as it stands.

    The planes of a W × H grid are stored with `PADDING` cells of wall on each side: cell (x, y) is
    element [x + PADDING, y + PADDING].

    Attributes:
      tiles: uint8[W + 2 · PADDING, H + 2 · PADDING], packed tiles (see `tiles`).
      marks: uint16, same shape; identities and contents that no tile code can show.
      position: int32[2], the agent's (x, y), without padding.
      direction: int32 scalar; 0 right (+x), 1 down (+y), 2 left, 3 up.
      carrying: uint8 scalar, packed tile in the agent's hands, 0 when they are empty.
      carrying_mark: uint16 scalar, the mark of what is carried.
    """

    tiles: jax.Array
    marks: jax.Array
    position: jax.Array
    direction: jax.Array
    carrying: jax.Array
    carrying_mark: jax.Array
