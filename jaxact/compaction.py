"""Work on the few entries of a batch that need it, instead of on all of them.

Under `vmap` a branch or a loop is taken by the whole batch as soon as one entry needs it. Where few
do, it is cheaper to bring these together first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

PyTree = Any


def for_each_chosen(
    mask: jax.Array,
    carry: PyTree,
    work: Callable[[jax.Array, jax.Array, PyTree], tuple[jax.Array, PyTree]],
    share: int = 64,
) -> PyTree:
    """Works on the entries chosen by a mask, a few at a time, for as long as there are any.

    Args:
      mask: bool [N], which entries need work.
      carry: what the work changes.
      work: (places [n], rows [n], carry) -> (again bool [n], carry). `rows` are the entries to read
        from, always valid; `places` are the same entries to write to, with N, which a write with
        mode="drop" ignores, where there are fewer than n to be done. Entries for which `again` is
        true will be worked on once more.
      share: n is N / share, at least 8.

    Returns:
      The carry at the end.
    """
    size = mask.shape[0]
    indices = jnp.arange(size, dtype=jnp.int32)
    nothing = jnp.full(min(size, max(8, size // share)), size, jnp.int32)

    def some_left(state: tuple[jax.Array, PyTree]) -> jax.Array:
        return jnp.any(state[0])

    def do_some(state: tuple[jax.Array, PyTree]) -> tuple[jax.Array, PyTree]:
        left, carry = state
        rank = jnp.where(left, jnp.cumsum(left, dtype=jnp.int32) - 1, size)
        places = nothing.at[rank].set(indices, mode="drop")
        again, carry = work(places, jnp.minimum(places, size - 1), carry)
        return left.at[places].set(again, mode="drop"), carry

    return jax.lax.while_loop(some_left, do_some, (mask, carry))[1]
