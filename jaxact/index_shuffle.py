"""Pseudo-random permutations of 0 … n − 1, computed for any index by itself.

A Feistel network on pairs of digits (Black and Rogaway 2002, "Ciphers with arbitrary finite
domains"): an index is written as a pair (left, right) with as many values as a rectangle that just
holds n has cells, and each round adds to one digit a hash of the other one. What lands outside of
0 … n − 1 goes through the network again until it does not ("cycle walking"), which keeps it a
permutation. No table is held and nothing is sorted.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

_ROUNDS = 8


def shuffled(index: jax.Array, size: int, key: jax.Array) -> jax.Array:
    """Returns the places of indices in a permutation.

    Args:
      index: uint32 [...], each less than `size`.
      size: how many there are to permute, at least 1 (static).
      key: uint32 [...], which permutation.

    Returns:
      uint32 [...]: over all indices with one key, each of 0 … size − 1 once.
    """
    width = math.isqrt(size - 1) + 1
    height = -(-size // width)
    index, key = jnp.broadcast_arrays(index, key)

    def two_rounds(number: jax.Array, digits: tuple[jax.Array, jax.Array]) -> Any:
        left, right = digits
        left = (left + hashed(right, key + 2 * number)) % jnp.uint32(width)
        right = (right + hashed(left, key + 2 * number + 1)) % jnp.uint32(height)
        return left, right

    def walk(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        index, outside = state
        digits = index // jnp.uint32(height), index % jnp.uint32(height)
        # Loops rather than one long expression, which XLA would take its time to compile.
        left, right = jax.lax.fori_loop(jnp.uint32(0), jnp.uint32(_ROUNDS // 2), two_rounds, digits)
        index = jnp.where(outside, left * jnp.uint32(height) + right, index)
        return index, index >= jnp.uint32(size)

    start = (index, jnp.ones_like(index, bool))
    return jax.lax.while_loop(lambda state: jnp.any(state[1]), walk, start)[0]


def hashed(word: jax.Array, key: jax.Array) -> jax.Array:
    """Mixes words uint32 [...] with keys uint32 [...] (twice the finalizer of MurmurHash3)."""
    return _mixed(_mixed(word ^ jnp.uint32(0x9E3779B9)) + key)


def _mixed(word: jax.Array) -> jax.Array:
    word = (word ^ (word >> jnp.uint32(16))) * jnp.uint32(0x85EBCA6B)
    word = (word ^ (word >> jnp.uint32(13))) * jnp.uint32(0xC2B2AE35)
    return word ^ (word >> jnp.uint32(16))
