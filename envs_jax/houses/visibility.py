"""What is visible to an agent by AI2-THOR's rule, and from where things can be seen.

An object is visible if one of its visibility points lies in the camera's frustum, is no further
from the agent's axis than the greatest distance along x and along z (a square, not a circle), and
if the ray from the camera towards it meets the object before anything else, within that distance.
This is not the same as being in the picture: a thing can fill it and be too far, or show only a
part that has no visibility point. A box has 14 of them, near its corners and the middles of its
faces.

Source: `CheckIfVisibilityPointInViewport` and its callers in AI2-THOR's
`BaseFPSAgentController.cs`; there, artists placed the points.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.collision import is_free
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, SINE, forward
from envs_jax.houses.state import Body

# How far out the visibility points are, of the way from the centre to the surface.
_DEPTH = 0.9
# Where view points are looked for: in how many directions from a box, and how far from its sides
# a body's surface is then, metres.
_DIRECTIONS = 12
_GAPS = (0.05, 0.25, 0.5)
# Has no divisor in common with how many there are: the first few of them lie all around.
_STRIDE = 7


def _unit_points() -> np.ndarray:
    corners = list(itertools.product((-1, 1), repeat=3))
    faces = [row for row in itertools.product((-1, 0, 1), repeat=3) if np.abs(row).sum() == 1]
    return _DEPTH * np.array(corners + faces, np.float32)


_POINTS = _unit_points()


@dataclass(frozen=True)
class Sight:
    """How well an agent sees.

    Attributes:
      field_of_view: vertical, degrees.
      aspect: the picture's width by its height.
      distance: metres, the greatest.
      instances: how many boxes of a category are looked at, the nearest in plan.
    """

    numbers_are_structure: ClassVar[bool] = True

    field_of_view: float
    aspect: float
    distance: float
    instances: int = 4


# A LoCoBot's camera takes 640 x 480 pixels and 79 degrees across.
ROBOTHOR_SIGHT = Sight(field_of_view=63.453, aspect=4 / 3, distance=1.0)


def visibility_points(boxes: jax.Array) -> jax.Array:
    """Returns the visibility points float32 [..., 14, 3] of boxes float32 [..., 8]."""
    local = boxes[..., None, HALF_SIZE] * _POINTS
    cosine, sine = boxes[..., None, COSINE], boxes[..., None, SINE]
    x = cosine * local[..., 0] + sine * local[..., 2]
    z = cosine * local[..., 2] - sine * local[..., 0]
    return boxes[..., None, CENTER] + jnp.stack([x, local[..., 1], z], axis=-1)


def entries(boxes: jax.Array, origin: jax.Array, points: jax.Array) -> jax.Array:
    """Returns where the segments from an origin to points enter boxes.

    Args:
      boxes: float32 [N, 8].
      origin: float32 [3].
      points: float32 [P, 3].

    Returns:
      float32 [P, N], shares of the segment (more than 1 is behind the point); infinite for boxes
      that are missed, and for those that the origin is in.
    """
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]

    def local(vectors: jax.Array) -> jax.Array:
        x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
        x, z = cosine * x - sine * z, sine * x + cosine * z
        return jnp.stack([x, jnp.broadcast_to(y, x.shape), z], axis=-1)

    start = local(origin - boxes[:, CENTER])
    way = local((points - origin)[:, None])
    way = jnp.where(jnp.abs(way) < 1e-9, 1e-9, way)
    size = boxes[:, HALF_SIZE] / jnp.abs(way)
    enters = jnp.max(-start / way - size, axis=-1)
    leaves = jnp.min(-start / way + size, axis=-1)
    return jnp.where((enters < leaves) & (enters > 0), enters, jnp.inf)


def met_first(
    boxes: jax.Array, row: jax.Array, origin: jax.Array, points: jax.Array, reach: float
) -> jax.Array:
    """Returns bool [P]: whether the ray to each point meets a box first, and within reach.

    Args:
      boxes: float32 [N, 8].
      row: int32 scalar, of the box to be met.
      origin: float32 [3], of the rays.
      points: float32 [P, 3].
      reach: metres.
    """
    shares = entries(boxes, origin, points)
    own = shares[:, row]
    length = jnp.sqrt(jnp.sum((points - origin) ** 2, axis=-1))
    return (own <= jnp.min(shares, axis=-1)) & (own * length <= reach)


def camera(position: jax.Array, body: Body) -> jax.Array:
    """Returns where the camera is, float32 [3], of an agent at a plan float32 [2]."""
    return jnp.stack([position[0], jnp.asarray(body.camera_height, jnp.float32), position[1]])


def in_frustum(
    sight: Sight, eye: jax.Array, yaw: jax.Array, pitch: jax.Array, points: jax.Array
) -> jax.Array:
    """Returns bool [...]: which points float32 [..., 3] are in the picture's pyramid.

    Args:
      sight: whose field of view.
      eye: float32 [3].
      yaw: float32 scalar, degrees.
      pitch: float32 scalar, degrees down.
      points: float32 [..., 3].
    """
    ahead = forward(yaw)
    offset = points - eye
    right = offset[..., 0] * ahead[1] - offset[..., 2] * ahead[0]
    level = offset[..., 0] * ahead[0] + offset[..., 2] * ahead[1]
    down = jnp.deg2rad(pitch)
    depth = jnp.cos(down) * level - jnp.sin(down) * offset[..., 1]
    up = jnp.sin(down) * level + jnp.cos(down) * offset[..., 1]
    tall = math.tan(math.radians(sight.field_of_view) / 2)
    return (
        (depth > 0)
        & (jnp.abs(up) <= tall * depth)
        & (jnp.abs(right) <= sight.aspect * tall * depth)
    )


def nearest(boxes: jax.Array, wanted: jax.Array, position: jax.Array, count: int) -> jax.Array:
    """Returns int32 [count], the wanted rows (bool [N]) whose centres are nearest in plan.

    Where fewer are wanted, the rest are any others.
    """
    away = jnp.sum((boxes[:, CENTER][:, ::2] - position) ** 2, axis=-1)
    numbers = jnp.arange(boxes.shape[0], dtype=jnp.int32)
    # What is not wanted is not as far as what has been taken.
    away = jnp.where(wanted, away, jnp.finfo(jnp.float32).max)

    def take(away: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        row = jnp.argmin(away).astype(jnp.int32)
        return jnp.where(numbers == row, jnp.inf, away), row

    return jax.lax.scan(take, away, length=min(count, boxes.shape[0]))[1]


def seen_points(
    sight: Sight, body: Body, boxes: jax.Array, wanted: jax.Array, position: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Finds the visibility points that an agent sees if it turns to them.

    Args:
      sight: of the agent.
      body: of the agent.
      boxes: float32 [N, 8].
      wanted: bool [N], whose points.
      position: float32 [2], of the agent.

    Returns:
      The points float32 [I · 14, 3] of the I nearest wanted boxes, and bool [I · 14], which are
      near enough and not hidden.
    """
    eye = camera(position, body)

    def look(row: jax.Array) -> tuple[jax.Array, jax.Array]:
        points = visibility_points(boxes[row])
        beside = jnp.abs(points[:, ::2] - position)
        near = jnp.all(beside <= sight.distance, axis=-1) & wanted[row]
        return points, near & met_first(boxes, row, eye, points, sight.distance)

    points, seen = jax.vmap(look)(nearest(boxes, wanted, position, sight.instances))
    return points.reshape(-1, 3), seen.reshape(-1)


def is_visible(
    sight: Sight,
    body: Body,
    boxes: jax.Array,
    wanted: jax.Array,
    position: jax.Array,
    yaw: jax.Array,
    pitch: jax.Array,
) -> jax.Array:
    """Returns a bool scalar: whether one of the wanted boxes (bool [N]) is visible."""
    points, seen = seen_points(sight, body, boxes, wanted, position)
    return jnp.any(seen & in_frustum(sight, camera(position, body), yaw, pitch, points))


def view_points(
    sight: Sight, body: Body, boxes: jax.Array, obstacles: jax.Array, row: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Finds places from which a box is visible to whoever turns to it.

    They lie around the box at three distances from its sides, any few in a row on all sides.

    Args:
      sight: of the agent.
      body: of the agent.
      boxes: float32 [N, 8], of the scene.
      obstacles: float32 [N, 8], see `collision.obstacles`.
      row: int32 scalar, of the box.

    Returns:
      Plans float32 [36, 2] and bool [36], which of them there is room at and see the box.
    """
    box = boxes[row]
    angle = jnp.arange(_DIRECTIONS, dtype=jnp.float32) * (2 * math.pi / _DIRECTIONS)
    way = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
    half = box[HALF_SIZE][::2]
    # Where the box's outline is in each direction.
    outline = jnp.min(half / jnp.maximum(jnp.abs(way), 1e-6), axis=-1)[:, None] * way
    gaps = body.radius + jnp.asarray(_GAPS, jnp.float32)
    local = (outline + gaps[:, None, None] * way).reshape(-1, 2)
    count = local.shape[0]
    local = local[(_STRIDE * np.arange(count, dtype=np.int32)) % count]
    cosine, sine = box[COSINE], box[SINE]
    turned = [cosine * local[:, 0] + sine * local[:, 1], cosine * local[:, 1] - sine * local[:, 0]]
    places = box[CENTER][::2] + jnp.stack(turned, axis=-1)
    wanted = jnp.arange(boxes.shape[0], dtype=jnp.int32) == row
    single = replace(sight, instances=1)

    def good(place: jax.Array) -> jax.Array:
        _, seen = seen_points(single, body, boxes, wanted, place)
        return jnp.any(seen) & is_free(obstacles, body.radius, place)

    return places, jax.vmap(good)(places)
