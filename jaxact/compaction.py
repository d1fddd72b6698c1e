"""Work on the few entries of a batch that need it, instead of on all of them.

Under `vmap` a branch or a loop is taken by the whole batch as soon as one entry needs it. Where few
do, it is cheaper to bring these together first.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

PyTree = Any


def together(work: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Makes of a function of N entries one of a single entry, to be used under `vmap`.

    Args:
      work: pytrees of arrays with a leading axis N in, a pytree of such arrays out.

    Returns:
      A function of the same arguments without that axis. However many times it is under `vmap`,
      `work` gets all entries in one call.
    """

    @custom_vmap
    def at_once(*arguments: Any) -> PyTree:
        return work(*arguments)

    @at_once.def_vmap
    def fold(axis_size: int, in_batched: Any, *arguments: Any) -> tuple[PyTree, PyTree]:
        batched = jax.tree.map(
            lambda leaf, is_batched: (
                leaf if is_batched else jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
            ),
            arguments,
            tuple(in_batched),
        )
        entries = jax.tree.leaves(batched)[0].shape[1]
        flat = jax.tree.map(
            lambda leaf: leaf.reshape(axis_size * entries, *leaf.shape[2:]), batched
        )
        result = jax.tree.map(
            lambda leaf: leaf.reshape(axis_size, entries, *leaf.shape[1:]), at_once(*flat)
        )
        return result, jax.tree.map(lambda _: True, result)

    @functools.wraps(work)
    def alone(*arguments: Any) -> PyTree:
        one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], arguments)
        return jax.tree.map(lambda leaf: leaf[0], at_once(*one))

    return alone


@custom_vmap
def anywhere(condition: jax.Array) -> jax.Array:
    """Returns whether a condition, bool scalar, holds in any of the entries of a `vmap`.

    A loop that goes on while this is true does so for all entries together. It needs no copy of
    what it carries for those that are done, as JAX would make at every pass; its body has to leave
    them as they are, or as good.
    """
    return condition


@anywhere.def_vmap
def _anywhere_in_batch(
    axis_size: int, in_batched: Any, condition: jax.Array
) -> tuple[jax.Array, bool]:
    del axis_size, in_batched
    return anywhere(jnp.any(condition)), False


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
        from; `places` are the same entries to write to. Where there are fewer than n to be done,
        places are N, which a write with mode="drop" ignores, and rows are the first one again, so
        that nothing is read but what was chosen. Entries for which `again` is true will be worked
        on once more.
      share: n is N / share, at least 8.

    Returns:
      The carry at the end.
    """
    size = mask.shape[0]
    indices = jnp.arange(size, dtype=jnp.int32)
    nothing = jnp.full(min(size, max(8, size // share)), size, jnp.int32)

    def some_left(state: tuple[jax.Array, PyTree]) -> jax.Array:
        return anywhere(jnp.any(state[0]))

    def do_some(state: tuple[jax.Array, PyTree]) -> tuple[jax.Array, PyTree]:
        left, carry = state
        rank = jnp.where(left, jnp.cumsum(left, dtype=jnp.int32) - 1, size)
        places = nothing.at[rank].set(indices, mode="drop")
        # Under `vmap` there may be none at all here, and any row will do.
        rows = jnp.where(places < size, places, jnp.minimum(places[0], size - 1))
        again, carry = work(places, rows, carry)
        return left.at[places].set(again, mode="drop"), carry

    return jax.lax.while_loop(some_left, do_some, (mask, carry))[1]


def put_rows(tree: PyTree, places: jax.Array, rows: PyTree) -> PyTree:
    """Writes rows [n, ...] to places [n] of a tree of arrays [N, ...]; places of N are ignored."""
    return jax.tree.map(lambda leaf, new: leaf.at[places].set(new, mode="drop"), tree, rows)


def while_loop_for_few(
    is_left: Callable[[PyTree, PyTree], jax.Array],
    advance: Callable[[PyTree, PyTree], PyTree],
    carry: PyTree,
    constants: PyTree,
    share: int = 8,
) -> PyTree:
    """Is `lax.while_loop` for loops that, under `vmap`, few entries enter at all.

    Args:
      is_left: (carry, constants) -> bool scalar, whether to go on.
      advance: (carry, constants) -> carry.
      carry: what the loop begins with.
      constants: what the loop reads; everything batched has to be passed here or in the carry.
      share: see `for_each_chosen`.

    Returns:
      The carry at the end.
    """

    def loop(carry: PyTree, constants: PyTree) -> PyTree:
        return jax.lax.while_loop(
            lambda carry: is_left(carry, constants), lambda carry: advance(carry, constants), carry
        )

    @together
    def loops(carry: PyTree, constants: PyTree) -> PyTree:
        def work(places: jax.Array, rows: jax.Array, carry: PyTree) -> tuple[jax.Array, PyTree]:
            chosen = jax.tree.map(lambda leaf: leaf[rows], (carry, constants))
            ended = jax.vmap(loop)(*chosen)
            return jnp.zeros(places.shape, jnp.bool_), put_rows(carry, places, ended)

        return for_each_chosen(jax.vmap(is_left)(carry, constants), carry, work, share)

    return loops(carry, constants)
