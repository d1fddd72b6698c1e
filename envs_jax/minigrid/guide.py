"""The ways from everywhere at once, for worlds that do not change; bitboards as in `planner`."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax

from envs_jax.minigrid.planner import Board, behind, contains
from jaxact.compaction import together


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Guide:
    """The beginnings of shortest plans from all poses, in a world that does not change.

    Attributes:
      left: word[4, H], poses from which a plan begins with a turn to the left.
      right: word[4, H], those of the others from which it begins with a turn to the right.
      near: word[4, H], poses from which few actions lead to a goal pose.
      reached: word[H], cells from which there is a plan.
    """

    left: Board
    right: Board
    near: Board
    reached: Board


def make_guide(walkable: Board, targets: Board, near: int) -> Guide:
    """Finds the beginnings of shortest plans from everywhere: those of `planner.plan`.

    Args:
      walkable: word[H], cells entered by a step forward; there are no others to get through.
      targets: word[H], cells; goals are the poses that face one of them.
      near: how many actions to a goal pose are few.
    """
    return _guide(walkable, targets, jnp.asarray(near, jnp.int32))


# Actions so far; boards word[4, H, N]: poses reached, left, right and near; whether any grew.
_Search = tuple[jax.Array, tuple[Board, Board, Board, Board], jax.Array]


@together
def _guide(walkable: Board, targets: Board, near: jax.Array) -> Guide:
    """Guides N lanes at once; every argument has a leading axis N."""
    open_ = walkable.T

    def grow(carry: _Search) -> _Search:
        actions, (now, left, right, close), _ = carry
        before, after = jnp.roll(now, 1, axis=0), jnp.roll(now, -1, axis=0)
        new = (before | after | jnp.stack(behind(tuple(now)))) & open_ & ~now
        left, right = left | new & before, right | new & after & ~before
        close = jnp.where(actions < near, close | new, close)
        return actions + 1, (now | new, left, right, close), jnp.any(new != 0)

    seeds = jnp.stack(behind((targets.T,) * 4)) & open_
    nothing = jnp.zeros_like(seeds)
    close = jnp.where(near >= 0, seeds, nothing)
    begin = (jnp.int32(0), (seeds, nothing, nothing, close), jnp.bool_(True))
    _, boards, _ = lax.while_loop(lambda carry: carry[-1], grow, begin)
    reached, left, right, close = (jnp.moveaxis(board, -1, 0) for board in boards)
    return Guide(left, right, close, reached[:, 0])


def holds(poses: Board, position: jax.Array, direction: jax.Array) -> jax.Array:
    """Says whether word[4, H] has the pose at `position`, int32[2], in `direction`; bool scalar."""
    return contains(poses[direction], position)
