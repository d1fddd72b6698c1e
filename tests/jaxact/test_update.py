"""The pieces of an update: dealing minibatches, clipping gradients, normalising advantages."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxact import EarlyStopping, Stage, TrainingPipeline, make_train
from jaxact.losses import PPO, Imitation
from jaxact.train_state import make_key, optimizer_for
from jaxact.update import _early_stopping, _minibatch_lanes
from tests.tiny import UPDATE, experiment


def deal(keys, minibatches):
    return jax.jit(_minibatch_lanes, static_argnums=1)(keys, minibatches)


@pytest.mark.parametrize(("lanes", "minibatches"), [(12, 1), (12, 4), (12, 12)])
def test_every_lane_is_dealt_to_exactly_one_minibatch(lanes, minibatches):
    order = deal(jax.random.split(make_key(0), lanes), minibatches)
    assert order.shape == (minibatches, lanes // minibatches)
    assert sorted(np.asarray(order).ravel().tolist()) == list(range(lanes))


def test_every_deal_is_another_and_fair():
    counts, deals = np.zeros((12, 4)), set()
    for keys in jax.random.split(make_key(0), (400, 12)):
        order = np.asarray(deal(keys, 4))
        deals.add(order.tobytes())
        for minibatch in range(4):
            counts[order[minibatch], minibatch] += 1
    assert len(deals) > 380  # of 13,824 that there are
    # Each lane comes to each minibatch in a quarter of the deals: 100, give or take 5 deviations.
    assert np.all(np.abs(counts - 100) < 5 * np.sqrt(400 * 0.25 * 0.75))


def test_the_deal_is_the_same_on_any_number_of_devices():
    keys = jax.random.split(make_key(3), 16)
    together = deal(keys, 4)
    shares = [np.asarray(deal(keys[i : i + 8], 4)) + i for i in (0, 8)]
    for minibatch in range(4):
        parts = np.concatenate([share[minibatch] for share in shares])
        assert sorted(parts.tolist()) == sorted(np.asarray(together)[minibatch].tolist())


def settings(**changes):
    return TrainingPipeline((Stage({"ppo": PPO()}, steps=1),), **changes)


def test_gradients_are_scaled_down_to_the_global_norm():
    pipeline = settings(max_grad_norm=0.5, optimizer=optax.sgd, optimizer_options={})
    optimizer = optimizer_for(pipeline, 0.1)
    large = {"a": jnp.array([30.0, 0.0]), "b": jnp.array([40.0])}
    updates, _ = optimizer.update(large, optimizer.init(large))
    # Norm 50 becomes 0.5 in the same direction, times the learning rate.
    np.testing.assert_allclose(updates["a"], [-0.03, 0.0], rtol=1e-6)
    np.testing.assert_allclose(updates["b"], [-0.04], rtol=1e-6)
    small = jax.tree.map(lambda x: x / 1000.0, large)
    updates, _ = optimizer.update(small, optimizer.init(small))
    np.testing.assert_allclose(updates["b"], [-0.004], rtol=1e-6)


def test_early_stopping_looks_at_whole_blocks():
    stage = Stage({"ppo": PPO()}, steps=1, stop=EarlyStopping(at_least=0.9, episodes=10))

    def add(block, success, count):
        episodes = {"success": jnp.float32(success), "count": jnp.float32(count)}
        block, stop = _early_stopping(stage, jnp.asarray(block, jnp.float32), episodes)
        return np.asarray(block).tolist(), bool(stop)

    assert add([0, 0], 9, 9) == ([9, 9], False)  # not enough episodes yet
    assert add([9, 9], 0, 1) == ([0, 0], True)  # 9 of 10
    assert add([9, 9], 1, 3) == ([0, 0], False)  # 10 of 12, and the next block begins
    assert add([0, 0], 0, 0) == ([0, 0], False)


def test_without_a_rule_no_stage_stops():
    stage = Stage({"ppo": PPO()}, steps=1)
    _, stop = _early_stopping(stage, jnp.zeros(2, jnp.float32), {})
    assert not bool(stop)


def test_no_stage_stops_for_the_episodes_of_the_one_before():
    """The second has at most UPDATE episodes, so that its block is never full."""
    enough = EarlyStopping(at_least=0.0, episodes=UPDATE + 1)
    never = EarlyStopping(at_least=2.0, episodes=1000)
    losses = {"imitation": Imitation()}
    stages = (
        Stage(losses, steps=4 * UPDATE, teacher_forcing=1.0, stop=never),
        Stage(losses, steps=UPDATE, teacher_forcing=1.0, stop=enough),
    )
    state, metrics = jax.jit(make_train(experiment(stages=stages)))(make_key(0))
    counts = np.asarray(metrics["episodes/count"])
    assert counts[:4].sum() > UPDATE
    assert not np.any(state.stopped)
    np.testing.assert_array_equal(state.block[:, 1], [counts[:4].sum(), counts[4]])
