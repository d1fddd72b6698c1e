"""Where a body can stand and how far it can move: a circle among turned rectangles, in plan.

Everything is exact: the circle touches a rectangle where its centre touches the rectangle grown by
its radius, whose corners are round, and a move is a segment against those shapes, so that no wall
is too thin to stop it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, NOWHERE, SINE, to_local
from envs_jax.houses.state import Body

# Metres above the floor that a body rolls over.
STEP_OVER = 0.02
# Metres between a body and what it was stopped by; within it, a move is judged by its direction.
SKIN = 1e-3
_TOUCHING = 1e-4


def obstacles(boxes: jax.Array, body: Body) -> jax.Array:
    """Returns boxes float32 [N, 8] with those moved `NOWHERE` that a body passes over or under.

    Args:
      boxes: float32 [N, 8], of a `Scene`.
      body: whose height counts.
    """
    half = boxes[:, HALF_SIZE][:, 1]
    height = boxes[:, CENTER][:, 1]
    blocks = (height - half < body.height) & (height + half > STEP_OVER)
    nowhere = boxes.at[:, CENTER].set(NOWHERE)
    return jnp.where(blocks[:, None], boxes, nowhere)


def clearance(obstacles: jax.Array, position: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns how far a point is from each rectangle and the way out.

    Args:
      obstacles: float32 [N, 8].
      position: float32 [2], a plan.

    Returns:
      float32 [N], metres to the rectangle, negative inside, and float32 [N, 2], the unit plan
      vector along which this grows fastest.
    """
    local = to_local(obstacles, position)
    beyond = jnp.abs(local) - obstacles[:, HALF_SIZE][:, ::2]
    outside = jnp.maximum(beyond, 0)
    length = jnp.sqrt(jnp.sum(outside**2, axis=-1))
    distance = length + jnp.minimum(jnp.max(beyond, axis=-1), 0)
    along_x = beyond[:, 0] >= beyond[:, 1]
    inner = jnp.stack([along_x, ~along_x], axis=-1).astype(jnp.float32)
    way = jnp.where(length[:, None] > 0, outside / jnp.maximum(length, 1e-12)[:, None], inner)
    return distance, _to_plan(obstacles, jnp.where(local < 0, -way, way))


def is_free(obstacles: jax.Array, radius: float, position: jax.Array) -> jax.Array:
    """Returns a bool scalar: whether a body of this radius fits at a plan float32 [2]."""
    distance, _ = clearance(obstacles, position)
    return jnp.all(distance >= radius)


def sweep(
    obstacles: jax.Array, radius: float, position: jax.Array, move: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Returns how much of a move there is room for, and what ends it.

    What a body touches already, or is in by an accident of rounding, stops it only if the move
    leads further in: the distance from a rectangle is convex, so a move that does not begin by
    leading in never does.

    Args:
      obstacles: float32 [N, 8].
      radius: of the body.
      position: float32 [2], a plan.
      move: float32 [2].

    Returns:
      float32 scalar, the share of the move until first contact, infinite if there is none, and the
      int32 row of the obstacle met.
    """
    distance, way = clearance(obstacles, position)
    leads_in = jnp.sum(way * move, axis=-1) < -1e-6
    share = jnp.where(
        distance <= radius + _TOUCHING,
        jnp.where(leads_in, 0, jnp.inf),
        _entry(obstacles, radius, position, move),
    )
    row = jnp.argmin(share)
    return share[row], row.astype(jnp.int32)


def _entry(obstacles: jax.Array, radius: float, position: jax.Array, move: jax.Array) -> jax.Array:
    """Returns the share [N] of a move that begins outside until it enters each grown rectangle."""
    start = to_local(obstacles, position)
    cosine, sine = obstacles[:, COSINE], obstacles[:, SINE]
    way = jnp.stack([cosine * move[0] - sine * move[1], sine * move[0] + cosine * move[1]], axis=-1)
    way = jnp.where(jnp.abs(way) < 1e-9, 1e-9, way)
    half = obstacles[:, HALF_SIZE][:, ::2]
    first = jnp.full(obstacles.shape[:1], jnp.inf, jnp.float32)
    # The grown rectangle is the union of two longer rectangles and four circles.
    for grown in ((radius, 0.0), (0.0, radius)):
        size = half + jnp.array(grown, jnp.float32)
        near = -start / way - size / jnp.abs(way)
        far = -start / way + size / jnp.abs(way)
        enters, leaves = jnp.max(near, axis=-1), jnp.min(far, axis=-1)
        hit = (enters < leaves) & (enters >= 0) & (enters < 1)
        first = jnp.where(hit, jnp.minimum(first, enters), first)
    squared = jnp.sum(way**2, axis=-1)
    for corner in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        offset = start - half * jnp.array(corner, jnp.float32)
        towards = jnp.sum(offset * way, axis=-1)
        inside = towards**2 - squared * (jnp.sum(offset**2, axis=-1) - radius**2)
        enters = (-towards - jnp.sqrt(jnp.maximum(inside, 0))) / squared
        hit = (inside > 0) & (enters >= 0) & (enters < 1)
        first = jnp.where(hit, jnp.minimum(first, enters), first)
    return first


def _to_plan(obstacles: jax.Array, local: jax.Array) -> jax.Array:
    """Returns local vectors [N, 2] of each box as plan vectors."""
    cosine, sine = obstacles[:, COSINE], obstacles[:, SINE]
    x, z = local[:, 0], local[:, 1]
    return jnp.stack([cosine * x + sine * z, cosine * z - sine * x], axis=-1)
