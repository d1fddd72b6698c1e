"""Permutations computed index by index."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.index_shuffle import shuffled


def permutation(size, key):
    return np.asarray(shuffled(jnp.arange(size, dtype=jnp.uint32), size, jnp.uint32(key)))


@pytest.mark.parametrize("size", [1, 3, 16, 4097])
def test_each_index_once(size):
    np.testing.assert_array_equal(np.sort(permutation(size, 5)), np.arange(size))


def test_keys_give_different_orders():
    one, other = permutation(1000, 1), permutation(1000, 2)
    assert (one == other).mean() < 0.02
    assert (one == np.arange(1000)).mean() < 0.02


@pytest.mark.parametrize("size", [2, 3, 12])
def test_every_place_is_as_likely_as_any(size):
    """Counts of (index, place) over many keys, against the χ² that independent draws would have."""
    keys = 4000
    places = jax.jit(jax.vmap(lambda key: shuffled(jnp.arange(size, dtype=jnp.uint32), size, key)))(
        jnp.arange(keys, dtype=jnp.uint32)
    )
    counts = np.zeros((size, size))
    for index in range(size):
        counts[index] = np.bincount(np.asarray(places[:, index]), minlength=size)
    expected = keys / size
    squares = ((counts - expected) ** 2 / expected).sum()
    freedom = (size - 1) ** 2
    assert squares < freedom + 5 * np.sqrt(2 * freedom)


def test_neighbours_are_scattered():
    """Differences of successive places are those of a random order: uncorrelated."""
    places = permutation(4096, 3).astype(float)
    assert abs(np.corrcoef(places[1:], places[:-1])[0, 1]) < 0.06
