"""A policy acts alike on one lane and in a batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Policy
from jaxact.train_state import init_params, make_key
from tests.tiny import experiment


@pytest.fixture(scope="module")
def policy():
    small = experiment()
    params = jax.jit(lambda key: init_params(small, key))(make_key(0))
    params = jax.tree.map(lambda x: x * 3.0, params)
    return Policy(small.model, params, small.pomdp.action_space)


OBSERVATION = {"vector": jnp.asarray(np.random.default_rng(0).uniform(size=(5, 12)), jnp.float32)}


def test_one_lane_is_a_batch_of_one(policy):
    act = jax.jit(lambda observation, memory: policy.act(KEY, observation, memory, greedy=True))
    batch, single = policy.initial_memory(5), policy.initial_memory()
    for _ in range(3):
        actions, batch = act(OBSERVATION, batch)
        one = jax.tree.map(lambda x: x[2], OBSERVATION)
        action, single = act(one, single)
        assert action.shape == ()
        assert int(action) == int(actions[2])
        np.testing.assert_allclose(single.model, batch.model[2], atol=1e-5)
        assert int(single.previous_action) == int(action)
        assert not bool(single.is_first)


KEY = make_key(7)


def test_memory_begins_empty(policy):
    memory = policy.initial_memory(3)
    assert np.asarray(memory.is_first).tolist() == [True] * 3
    assert np.asarray(memory.previous_action).tolist() == [0] * 3
    assert not np.asarray(memory.model).any()
    assert policy.initial_memory().is_first.shape == ()


def test_samples_follow_the_distribution(policy):
    observation = jax.tree.map(lambda x: jnp.tile(x[:1], (4000, 1)), OBSERVATION)
    memory = policy.initial_memory(4000)
    output, _ = jax.jit(policy.output)(observation, memory)
    action, _ = jax.jit(policy.act)(KEY, observation, memory)
    p = float(output.distribution.probabilities[0, 1])
    assert abs(float(jnp.mean(action.astype(jnp.float32))) - p) < 5 * np.sqrt(p * (1 - p) / 4000)


def test_the_key_decides(policy):
    memory = policy.initial_memory(5)
    act = jax.jit(policy.act)
    one, again = (act(KEY, OBSERVATION, memory)[0] for _ in range(2))
    np.testing.assert_array_equal(one, again)
    others = [np.asarray(act(make_key(n), OBSERVATION, memory)[0]) for n in range(20)]
    assert len({x.tobytes() for x in others}) > 1
