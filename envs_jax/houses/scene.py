"""What a house is made of: one fixed-size table of boxes.

Lengths are metres, angles degrees. The y axis points up and the floor is y = 0. At yaw 0 one looks
along +z with +x to the right, and yaw grows clockwise seen from above (AI2-THOR's frame), so that
forward is (sin yaw, 0, cos yaw). A plan is a pair (x, z).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

# Columns of `Scene.boxes`: centre, half the size along the box's own axes, and the yaw's cosine and
# sine.
CENTER = slice(0, 3)
HALF_SIZE = slice(3, 6)
COSINE, SINE = 6, 7
# Where boxes are that are not there: rows of padding, and what the agent carries.
NOWHERE = -1e4
# The box of a row of padding.
PADDING = (0.0, NOWHERE, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scene:
    """Walls, doors, furniture and objects as N boxes turned about the vertical axis.

    Attributes:
      boxes: float32 [N, 8], for each box its centre (x, y, z), half its size along its own x, y and
        z axes, and the cosine and sine of its yaw. Rows of padding are `PADDING`.
      other_boxes: float32 [N, 8], where each box goes when it is opened or, once it is open, when
        it is shut; the same as `boxes` for what cannot be opened.
      category: int32 [N], index into `categories.NAMES`; 0 for padding.
      color: float32 [N, 3], RGB in [0, 1].
      openable: bool [N].
      portable: bool [N], whether an agent can carry it.
      opened: bool [N].
      rooms: float32 [R, 4], rectangles (x low, z low, x high, z high); without area if unused.
      room_kind: int32 [R], index into `categories.ROOMS`; 0 if unused.
      ceiling: float32 scalar, height.
      surface: float32 [2, 3], RGB of the floor and of the ceiling.
    """

    boxes: jax.Array
    other_boxes: jax.Array
    category: jax.Array
    color: jax.Array
    openable: jax.Array
    portable: jax.Array
    opened: jax.Array
    rooms: jax.Array
    room_kind: jax.Array
    ceiling: jax.Array
    surface: jax.Array

    @property
    def present(self) -> jax.Array:
        """Bool [N], which rows are boxes that are somewhere."""
        return self.boxes[:, 1] > NOWHERE / 2


def box(center: jax.Array, half_size: jax.Array, yaw: jax.Array) -> jax.Array:
    """Returns a row float32 [..., 8] of `Scene.boxes`.

    Args:
      center: float32 [..., 3].
      half_size: float32 [..., 3].
      yaw: float32 [...], degrees.
    """
    turned = jnp.deg2rad(yaw)[..., None]
    return jnp.concatenate([center, half_size, jnp.cos(turned), jnp.sin(turned)], axis=-1)


def forward(yaw: jax.Array) -> jax.Array:
    """Returns the float32 [..., 2] unit plan vector (x, z) that leads forward."""
    turned = jnp.deg2rad(yaw)
    return jnp.stack([jnp.sin(turned), jnp.cos(turned)], axis=-1)


def to_local(boxes: jax.Array, plan: jax.Array) -> jax.Array:
    """Returns plans float32 [..., N, 2] in the frame of each box, from its centre.

    Args:
      boxes: float32 [N, 8].
      plan: float32 [..., 2].
    """
    x = plan[..., None, 0] - boxes[:, 0]
    z = plan[..., None, 1] - boxes[:, 2]
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]
    return jnp.stack([cosine * x - sine * z, sine * x + cosine * z], axis=-1)


def make_scene(
    boxes: Sequence[Sequence[float]],
    categories: Sequence[int],
    rooms: Sequence[Sequence[float]] = (),
    *,
    size: int | None = None,
    other_boxes: Sequence[Sequence[float] | None] | None = None,
    portable: Sequence[int] = (),
) -> Scene:
    """Makes a scene of a few boxes by hand, grey and with its doors shut.

    Args:
      boxes: for each its centre (x, y, z), its whole size (x, y, z) and its yaw in degrees.
      categories: of each, indices into `categories.NAMES`.
      rooms: rectangles (x low, z low, x high, z high), all of kind 0.
      size: N, how many rows there are with padding; None for no padding.
      other_boxes: for each box where it goes when it is opened; None if it cannot be.
      portable: rows that an agent can carry.
    """
    count = len(boxes) if size is None else size
    opened = other_boxes if other_boxes is not None else [None] * len(boxes)

    def rows(chosen: Sequence[Sequence[float]]) -> jax.Array:
        values = jnp.asarray(chosen, jnp.float32).reshape(-1, 7)
        made = box(values[:, :3], values[:, 3:6] / 2, values[:, 6])
        padding = jnp.array(PADDING, jnp.float32)
        return jnp.concatenate([made, jnp.tile(padding, (count - len(chosen), 1))])

    def flags(chosen: Sequence[int]) -> jax.Array:
        return jnp.zeros(count, bool).at[jnp.asarray(chosen, jnp.int32)].set(True)

    kinds = jnp.zeros(count, jnp.int32)
    kinds = kinds.at[: len(boxes)].set(jnp.asarray(categories, jnp.int32))
    openable = [row for row, place in enumerate(opened) if place is not None]
    places = [shut if place is None else place for shut, place in zip(boxes, opened, strict=True)]
    return Scene(
        boxes=rows(boxes),
        other_boxes=rows(places),
        category=kinds,
        color=jnp.zeros((count, 3), jnp.float32).at[: len(boxes)].set(0.5),
        openable=flags(openable),
        portable=flags(portable),
        opened=jnp.zeros(count, bool),
        rooms=jnp.asarray(rooms, jnp.float32).reshape(-1, 4),
        room_kind=jnp.zeros(len(rooms), jnp.int32),
        ceiling=jnp.float32(2.5),
        surface=jnp.full((2, 3), 0.5, jnp.float32),
    )
