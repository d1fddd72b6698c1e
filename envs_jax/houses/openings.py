"""Doors and drawers of furniture, and what is kept in fridges.

What opens is what opens in AI2-THOR: fridges, safes, the drawers of dressers, desks, side tables
and television stands, and the cabinets of counters. Each is one box with two places:

- a drawer is in its furniture, and comes out by its whole depth;
- a door lies on the front at one side, and stands out from it at its hinges;
- the upper part of a fridge is one box as long as it is shut. Open, there is only its door at the
  side, and what is kept in it stands on its lower part.

Shut they take no room that was free. Open they stand out by less than half of what is kept free
before furniture, so that they are in nothing, not even each other; but a body may not get past
them. So doors are narrow, and a fridge's is as if it were folded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.asset_sizes import SIZES
from envs_jax.houses.draws import Shape, first_true
from envs_jax.houses.furnishing import OPEN, PASSAGE, Pieces

# How far doors and drawers stand out from what they belong to: shut, so as to be seen, and open.
_RELIEF = 0.004
_REACH = PASSAGE / 2 - 0.01
_THICK = 0.02
# Of a fridge, so high is the part that does not open.
_SHELF = 0.7
# A drawer's height and how far below the top of its furniture it is; what is lower has a lower one.
_DRAWER, _BELOW_TOP = 0.16, 0.06
_FRIDGE = categories.index("Fridge")
# What opens, by furniture.
_FRONTS = {"Fridge": "Fridge", "Safe": "Safe", "CounterTop": "Cabinet"}
_FRONTS |= dict.fromkeys(("Dresser", "Desk", "SideTable", "TVStand"), "Drawer")


def _table() -> np.ndarray:
    """Returns for each category that of its front, int32 [C]; 0 for none."""
    table = np.zeros(len(categories.NAMES), np.int32)
    for name, front in _FRONTS.items():
        table[categories.index(name)] = categories.index(front)
    return table


_FRONT = _table()
_DRAWER_INDEX = categories.index("Drawer")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Openings:
    """Fronts of furniture, and things in fridges.

    Attributes:
      boxes: float32 [F, 8], rows of `Scene.boxes`, the fronts as they are shut.
      other_boxes: float32 [F, 8], the same open.
      category: int32 [F], 0 where there is none.
      kept: float32 [K, 8], what is kept.
      kept_category: int32 [K], 0 where there is none.
    """

    boxes: jax.Array
    other_boxes: jax.Array
    category: jax.Array
    kept: jax.Array
    kept_category: jax.Array


def shapes(fronts: int, kept: int) -> tuple[Shape, ...]:
    """Returns the shapes of the random numbers that `add_openings` takes."""
    return ((fronts,), (kept, 2))


def add_openings(
    draws: Sequence[jax.Array], furniture: Pieces, fronts: int, kept: tuple[int, ...]
) -> tuple[Pieces, Openings]:
    """Gives furniture doors and drawers, fridges first.

    Args:
      draws: uniform float32 of `shapes`.
      furniture: of `furnishing.furnish`.
      fronts: how many there are at most.
      kept: the categories of what is kept in the first fridge, the first on its left; absent if
        there is no fridge that opens.

    Returns:
      The furniture, where fridges that open are only as high as what does not open of them, and
      what opens.
    """
    stands = (furniture.place >= 0) & (furniture.place <= OPEN)
    kind = jnp.where(stands, jnp.asarray(_FRONT)[furniture.category], 0)
    is_fridge = kind == _FRIDGE
    count = len(kind)
    order, there = first_true(jnp.concatenate([is_fridge, (kind > 0) & ~is_fridge]), fronts)
    rows = order % count
    owner = Pieces(furniture.rows[rows])
    category = jnp.where(there, kind[rows], 0)
    fridge, drawer = category == _FRIDGE, category == _DRAWER_INDEX
    shut, opened = _places(draws[0], owner, fridge, drawer)

    opens = jnp.any((jnp.arange(count, dtype=jnp.int32) == rows[:, None]) & fridge[:, None], axis=0)
    height = 2 * furniture.half_size[:, 1]
    low = jnp.where(opens, jnp.minimum(height, _SHELF), height) / 2
    # The columns of `Pieces` that hold the middle's height and half the height.
    lowered = furniture.rows.at[:, 6].set(low).at[:, 9].set(low)
    things, thing_category = _keep(draws[1], Pieces(owner.rows[:1]), kept, fridge[:1])
    return Pieces(lowered), Openings(shut, opened, category, things, thing_category)


def _places(
    draws: jax.Array, owner: Pieces, fridge: jax.Array, drawer: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Returns where fronts are shut and open, rows float32 [F, 8] each.

    Args:
      draws: uniform float32 [F], on which side doors are hung.
      owner: [F], what they belong to.
      fridge: bool [F], whether it is the upper part of a fridge.
      drawer: bool [F], whether it is a drawer; otherwise it is a door.
    """
    half, zero = owner.half_size, jnp.zeros(len(draws), jnp.float32)
    width, depth, top = 0.95 * half[:, 0], half[:, 2], 2 * half[:, 1]
    low = jnp.where(fridge, _SHELF, jnp.where(drawer, top - _BELOW_TOP - _DRAWER, 0.05))
    low = jnp.where(drawer, jnp.maximum(low, 0.02), low)
    high = jnp.where(fridge, top, jnp.maximum(top - _BELOW_TOP, low + 0.02))
    out = jnp.minimum(2 * depth, _REACH) / 2
    leaf = jnp.minimum(2 * width, _REACH) / 2
    side = jnp.where(draws < 0.5, -1.0, 1.0)
    # Along the owner's own axes: the middle and half the size, shut.
    thick = jnp.where(fridge, depth, jnp.where(drawer, out, _THICK / 2))
    ahead = jnp.where(fridge, zero, depth + _RELIEF - thick)
    wide = jnp.where(fridge, half[:, 0], jnp.where(drawer, width, leaf))
    across = jnp.where(fridge | drawer, zero, side * (width - leaf))
    tall, middle = (high - low) / 2, (low + high) / 2
    shut = _row(owner, across, middle, ahead, jnp.stack([wide, tall, thick], axis=1))
    # A drawer comes out by all of its depth, a door stands across at its hinges.
    across = jnp.where(drawer, zero, side * (width - _THICK / 2))
    before = jnp.where(drawer, out, leaf)
    size = jnp.stack([jnp.where(drawer, width, _THICK / 2), tall, before], axis=1)
    opened = _row(owner, across, middle, depth + before + _RELIEF, size)
    return shut, opened


def _keep(
    draws: jax.Array, fridge: Pieces, names: tuple[int, ...], there: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Puts things side by side on the lower part of a fridge [1], near its front.

    Args:
      draws: uniform float32 [K, 2].
      fridge: one piece.
      names: the categories.
      there: bool [1], whether it is a fridge that opens.
    """
    count = len(names)
    if not count:
        return jnp.zeros((0, 8), jnp.float32), jnp.zeros(0, jnp.int32)
    sizes = np.array([SIZES[categories.NAMES[name]] for name in names], np.float32)
    half = jnp.asarray(sizes[:, 1] / 2)
    span = 2 * fridge.half_size[:, 0] / count
    # Each has a share of the width to itself, less what the door takes.
    room = jnp.maximum(span / 2 - half[:, 0] - 3 * _THICK, 0.0)
    middle = (jnp.arange(count, dtype=jnp.float32) + 0.5) * span - fridge.half_size[:, 0]
    across = middle + (2 * draws[:, 0] - 1) * room
    ahead = fridge.half_size[:, 2] - half[:, 2] - 0.03 - 0.05 * draws[:, 1]
    owner = Pieces(jnp.broadcast_to(fridge.rows, (count, fridge.rows.shape[1])))
    boxes = _row(owner, across, _SHELF + half[:, 1], ahead, half)
    return boxes, jnp.where(there, jnp.array(names, jnp.int32), 0)


def _row(
    owner: Pieces, across: jax.Array, height: jax.Array, ahead: jax.Array, half: jax.Array
) -> jax.Array:
    """Returns rows float32 [F, 8] of boxes at places in the frames of their owners.

    Args:
      owner: [F].
      across: float32 [F], metres along the owner's x axis.
      height: float32 [F], of the middle.
      ahead: float32 [F], metres along the owner's z axis, to its front.
      half: float32 [F, 3], half the size along the owner's axes.
    """
    cosine, sine = owner.turn[:, 0], owner.turn[:, 1]
    x = owner.center[:, 0] + cosine * across + sine * ahead
    z = owner.center[:, 2] + cosine * ahead - sine * across
    return jnp.concatenate([jnp.stack([x, height, z], axis=1), half, owner.turn], axis=1)
