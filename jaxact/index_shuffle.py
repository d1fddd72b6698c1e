"""Pseudo-random permutations of 0 … n − 1, computed for any index by itself.

A Feistel network on pairs of digits (Black and Rogaway 2002, "Ciphers with arbitrary finite
domains"): an index is written as a pair (left, right) with as many values as a rectangle that just
holds n has cells, and each round adds to one digit a hash of the other one. What lands outside of
0 … n − 1 goes through the network again until it does not ("cycle walking"), which keeps it a
permutation. No table is held and nothing is sorted.
"""

from __future__ import annotations

import math

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

    def network(index: jax.Array) -> jax.Array:
        left, right = index // jnp.uint32(height), index % jnp.uint32(height)
        for number in range(0, _ROUNDS, 2):
            left = (left + hashed(right, key + jnp.uint32(number))) % jnp.uint32(width)
            right = (right + hashed(left, key + jnp.uint32(number + 1))) % jnp.uint32(height)
        return left * jnp.uint32(height) + right

    def is_outside(index: jax.Array) -> jax.Array:
        return index >= jnp.uint32(size)

    return jax.lax.while_loop(
        lambda index: jnp.any(is_outside(index)),
        lambda index: jnp.where(is_outside(index), network(index), index),
        network(index),
    )


def hashed(word: jax.Array, key: jax.Array) -> jax.Array:
    """Mixes words uint32 [...] with keys uint32 [...] (twice the finalizer of MurmurHash3)."""
    return _mixed(_mixed(word ^ jnp.uint32(0x9E3779B9)) + key)


def _mixed(word: jax.Array) -> jax.Array:
    word = (word ^ (word >> jnp.uint32(16))) * jnp.uint32(0x85EBCA6B)
    word = (word ^ (word >> jnp.uint32(13))) * jnp.uint32(0xC2B2AE35)
    return word ^ (word >> jnp.uint32(16))
