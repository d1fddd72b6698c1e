"""Spaces contain what they sample, with the structure they say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.spaces import Box, Dict, Discrete, Tuple

SPACES = {
    "discrete": Discrete(5),
    "floats": Box(-2.0, 3.0, (3, 2)),
    "bytes": Box(0, 255, (4,), "uint8"),
    "signed bytes": Box(-128, 127, (4,), "int8"),
    "unbounded": Box(-np.inf, np.inf, (3,)),
    "half bounded": Box(0.0, np.inf, (3,)),
    "tuple": Tuple((Discrete(2), Box(0, 1, ()))),
    "dict": Dict({"b": Discrete(3), "a": Tuple((Discrete(2),))}),
}


@pytest.mark.parametrize("name", SPACES)
def test_samples_are_contained_and_structured(name):
    space = SPACES[name]
    keys = jax.random.split(jax.random.key(0), 200)
    samples, inside = jax.jit(
        jax.vmap(lambda key: (space.sample(key), space.contains(space.sample(key))))
    )(keys)
    assert bool(jnp.all(inside))
    describe = jax.tree.map(lambda x: (x.shape[1:], x.dtype), samples)
    assert describe == jax.tree.map(lambda x: (x.shape, x.dtype), space.structure)
    assert jax.tree.structure(space.zeros()) == jax.tree.structure(space.structure)
    assert hash(space) == hash(space)


def test_samples_reach_both_ends():
    keys = jax.random.split(jax.random.key(0), 5000)
    drawn = np.asarray(jax.jit(jax.vmap(Box(0, 255, (), "uint8").sample))(keys))
    assert (drawn.min(), drawn.max()) == (0, 255)
    drawn = np.asarray(jax.jit(jax.vmap(Discrete(5).sample))(keys))
    assert np.bincount(drawn, minlength=5).min() > 850  # 1000, give or take 5 deviations


@pytest.mark.parametrize(
    ("space", "value", "expected"),
    [
        (Discrete(3), 2, True),
        (Discrete(3), 3, False),
        (Discrete(3), -1, False),
        (Box(0.0, 1.0, (2,)), np.array([0.0, 1.0], np.float32), True),
        (Box(0.0, 1.0, (2,)), np.array([0.0, 1.1], np.float32), False),
        (Box(0.0, 1.0, (2,)), np.array([np.nan, 0.0], np.float32), False),
        (Tuple((Discrete(2), Discrete(3))), (1, 3), False),
        (Dict({"a": Discrete(2), "b": Discrete(3)}), {"a": 1, "b": 2}, True),
        (Dict({"a": Discrete(2), "b": Discrete(3)}), {"a": 2, "b": 2}, False),
    ],
)
def test_bounds(space, value, expected):
    assert bool(space.contains(value)) is expected


def test_the_order_of_names_does_not_matter():
    one = Dict({"a": Discrete(2), "b": Discrete(3)})
    other = Dict({"b": Discrete(3), "a": Discrete(2)})
    assert one == other
    assert list(other.spaces) == ["a", "b"]
