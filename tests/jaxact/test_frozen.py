"""Frozen mappings: equal to dicts, hashable, and nothing that changes."""

import copy
import pickle
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import pytest

from jaxact.frozen import FrozenMapping


def test_it_is_a_mapping_in_the_order_given():
    frozen = FrozenMapping([("b", 1), ("a", 2)])
    assert isinstance(frozen, Mapping)
    assert list(frozen.items()) == [("b", 1), ("a", 2)]
    assert frozen == {"a": 2, "b": 1} == frozen
    assert "c" not in frozen
    assert repr(frozen) == "FrozenMapping({'b': 1, 'a': 2})"
    assert FrozenMapping(frozen) == frozen
    assert FrozenMapping() == {}


def test_equal_ones_have_equal_hashes_in_any_order():
    one, other = FrozenMapping({"a": 1, "b": {"c": 2}}), FrozenMapping({"b": {"c": 2}, "a": 1})
    assert one == other
    assert hash(one) == hash(other)
    assert hash(one) != hash(FrozenMapping({"a": 1}))


def test_nothing_changes_it():
    inner = {"eps": 1.0}
    given = {"options": inner}
    frozen = FrozenMapping(given)
    given["more"], inner["eps"] = {}, 2.0
    assert frozen == {"options": {"eps": 1.0}}
    for mapping in (frozen, frozen["options"]):
        with pytest.raises(TypeError, match="does not support item assignment"):
            mapping["eps"] = 3.0


def test_it_can_be_copied_and_pickled():
    frozen = FrozenMapping({"a": {"b": 1}})
    for other in (copy.deepcopy(frozen), pickle.loads(pickle.dumps(frozen))):
        assert type(other) is FrozenMapping
        assert other == frozen


def test_it_may_hold_tracers_until_its_hash_is_taken():
    def double(x):
        return 2.0 * FrozenMapping({"x": x})["x"]

    assert float(jax.jit(double)(jnp.float32(3))) == 6.0
