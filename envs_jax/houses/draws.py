"""Random numbers drawn at once and cut into arrays.

XLA compiles a loop of its own wherever a key is split or drawn from. What needs dozens of draws
compiles many times faster with one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

Shape = tuple[int, ...]


def draw(key: jax.Array, shapes: Sequence[Shape]) -> list[jax.Array]:
    """Returns an array of each shape, float32, uniform in [0, 1) and independent.

    Args:
      key: a PRNG key.
      shapes: of the arrays.
    """
    sizes = [math.prod(shape) for shape in shapes]
    numbers = jax.random.uniform(key, (sum(sizes),), jnp.float32)
    arrays = []
    first = 0
    for size, shape in zip(sizes, shapes, strict=True):
        arrays.append(numbers[first : first + size].reshape(shape))
        first += size
    return arrays


def pick(draw: jax.Array, count: int) -> jax.Array:
    """Turns uniform `draw` [...] into int32 [...] in 0 … count − 1, each equally likely."""
    # A number just short of 1 times `count` may round to it.
    return jnp.minimum((draw * count).astype(jnp.int32), count - 1)


def first_true(good: jax.Array, count: int) -> tuple[jax.Array, jax.Array]:
    """Finds the first rows of bool [K] that are true, without a sort.

    Returns:
      int32 [count], the rows in order, and bool [count], whether there are so many; where there
      are not, the row is 0.
    """
    place = jnp.cumsum(good, dtype=jnp.int32) - 1
    chosen = good & (place == jnp.arange(count, dtype=jnp.int32)[:, None])
    rows = jnp.arange(good.shape[0], dtype=jnp.int32)
    return jnp.sum(jnp.where(chosen, rows, 0), axis=1, dtype=jnp.int32), jnp.any(chosen, axis=1)
