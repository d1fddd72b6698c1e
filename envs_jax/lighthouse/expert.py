"""The expert of a lighthouse: a shortest search with a view of some radius."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.lighthouse.views import GOAL, WALL, WRONG_CORNER


def search(known: jax.Array, border: jax.Array, last: jax.Array) -> jax.Array:
    """Returns the next action, an int32 scalar, from what `views.look` tells and the last action.

    Source: `FindGoalLightHouseTask.query_expert` of AllenAct, with `deterministic`.
    """
    return (_search_line if known.shape[0] == 2 else _search_square)(known, border, last)


def optimal_length(dim: int, radius: int, view_radius: int) -> float:
    """Returns the mean length of an episode of whoever sees that far and searches optimally."""
    unseen = max(radius - view_radius, 0)
    if dim == 1:
        return float(radius + unseen)
    # Two corners' distances to each corner in turn, then the view's to the goal in it.
    return (10 * 2 * unseen + 4 * 2 * min(view_radius, radius)) / 4


def _search_line(known: jax.Array, border: jax.Array, last: jax.Array) -> jax.Array:
    """Returns the expert's action on a line: right, until there is a reason to turn round."""
    right, left, none = 0, 1, 2
    action = jnp.select(
        [
            known[0] == GOAL,
            known[1] == GOAL,
            border != none,
            known[0] == WRONG_CORNER,
            known[1] == WRONG_CORNER,
            last == none,
        ],
        [left, right, jnp.where(last == right, left, right), right, left, right],
        last,
    )
    return action.astype(jnp.int32)


def _search_square(known: jax.Array, border: jax.Array, last: jax.Array) -> jax.Array:
    """Returns the expert's action in a square: a round anticlockwise, as far in as it can see.

    On such a round each action leads towards a corner, and is followed by the next action in turn.
    """
    right, none = 1, 4
    # Where down, right, up and left lead; corners go from top left to bottom right, row by row.
    towards = known[jnp.array([3, 1, 0, 2], jnp.int32)]
    is_wrong = towards == WRONG_CORNER
    neighbours = is_wrong & jnp.roll(is_wrong, -1)
    goal = jnp.argmax(towards == GOAL)
    wrong = jnp.sum(is_wrong, dtype=jnp.int32)
    same = jnp.all(known == known[0])
    # A view of radius 0 shows no wall from afar, and every corner as all four.
    at_end = (known[0] == WRONG_CORNER) | (last == border)
    turns = jnp.where(same & (border != none), at_end, towards[last % 4] == WALL)
    action = jnp.select(
        [
            jnp.any(towards == GOAL),
            wrong == 1,
            (wrong == 2) & jnp.any(neighbours),
            last == none,
        ],
        [
            jnp.where(border == goal, goal + 1, goal),
            jnp.argmax(is_wrong) + 2,
            jnp.argmax(neighbours) + 3,
            right,
        ],
        jnp.where(turns, last + 1, last),
    )
    return (action % 4).astype(jnp.int32)
