"""What can be known of a lighthouse with a view of some radius, by the agent and the expert."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.lighthouse.environment import LighthouseState, corners

# What there is to see in a cell.
EMPTY, GOAL, WRONG_CORNER, WALL = range(4)


def look(
    state: LighthouseState, goal: jax.Array, radius: int, view_radius: int
) -> tuple[jax.Array, jax.Array]:
    """Returns what an agent with this view knows.

    Args:
      state: the world.
      goal: int32 scalar, the goal's corner.
      radius: of the world.
      view_radius: how far one sees.

    Returns:
      int32[2^dim]: for each corner that has been in view, whether it is the `GOAL` or a
      `WRONG_CORNER`; for the others, what is in the corner of the view that lies in their
      direction. And an int32 scalar: the border that the agent touches, numbered like the action
      that leads there; 2 · dim for none, or before the first action. Of two borders it is the one
      that the last action led to, or else the first.
    """
    dim = state.position.shape[0]
    places = jnp.asarray(radius * corners(dim))
    inspected = state.position + jnp.asarray(view_radius * corners(dim))
    inspected = jnp.clip(inspected, -radius, radius)
    own = jnp.where(jnp.arange(2**dim, dtype=jnp.int32) == goal, GOAL, WRONG_CORNER)
    # On a corner of the world, and it need not be the one in that direction: a view of radius 0 is
    # the agent's own cell in all of them.
    on_corner = jnp.all(inspected[:, None] == places, axis=-1)
    seen = jnp.max(jnp.where(on_corner, own, EMPTY), axis=1)
    on_wall = jnp.any(jnp.abs(inspected) == radius, axis=1)
    seen = jnp.where(on_wall & (seen == EMPTY), WALL, seen)
    known = jnp.where(state.nearest <= view_radius, own, seen)

    touched = jnp.concatenate([state.position == radius, state.position == -radius])
    none = 2 * dim
    first = jnp.where(jnp.any(touched), jnp.argmax(touched), none)
    pushed = touched[jnp.minimum(state.last_action, none - 1)]
    border = jnp.where(pushed | (state.last_action == none), state.last_action, first)
    return known.astype(jnp.int32), border.astype(jnp.int32)
