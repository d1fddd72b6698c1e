"""Intrinsic rewards: the papers' formulas in NumPy, the same on any devices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.losses import Curiosity, RandomNetworkDistillation, Rewarding
from jaxact.models import Concatenated, Vector
from jaxact.moments import Moments, scale_by_returns
from tests.windows import (
    ACTIONS,
    IS_FIRST,
    PROGRESS,
    B,
    N,
    T,
    assert_same_on_two_devices,
    batch_of,
    normal,
    output_of,
    trajectory_of,
    variables_of,
)

ENCODER = Concatenated({"x": Vector((5,)), "y": Vector((3,))})
OBSERVATION = {
    "x": 3.0 * normal(0, T, B, 4) + 2.0,
    "y": np.random.default_rng(1).integers(0, 9, (T, B, 2)).astype(np.uint8),
}
NEXT = {name: np.roll(x, -1, axis=0) for name, x in OBSERVATION.items()}
ICM = Curiosity(action_space=ACTIONS, encoder=ENCODER, hidden=7, eta=0.5, beta=0.2)
RND = RandomNetworkDistillation(encoder=ENCODER, features=6, hidden=7, discount=0.9)
BATCH = batch_of(jax.tree.map(jnp.asarray, OBSERVATION))
ACTION = np.asarray(BATCH.action)
INSIDE = np.concatenate([~IS_FIRST[1:], np.zeros((1, B), bool)])


def trajectory(before=OBSERVATION, after=NEXT, action=ACTION, finished=~INSIDE):
    return trajectory_of(before, action, after, finished)


def dense(p, x):
    return x @ np.asarray(p["kernel"]) + np.asarray(p["bias"])


def encode(p, observation):
    parts = [
        np.tanh(dense(p[name]["Dense_0"], observation[sensor].astype(np.float32)))
        for name, sensor in (("encoders_x", "x"), ("encoders_y", "y"))
    ]
    return np.concatenate(parts, -1)


def numpy_icm(p, before, after, action):
    """−log p(a | φ, φ′) and ½‖φ̂ − φ′‖²."""
    q = p["dynamics"]
    before, after = encode(p["encoder"], before), encode(p["encoder"], after)
    hidden = np.maximum(0, dense(q["inverse_hidden"], np.concatenate([before, after], -1)))
    logits = dense(q["inverse"]["Dense_0"], hidden)
    log_probs = logits - np.log(np.exp(logits).sum(-1, keepdims=True))
    acted = np.concatenate([before, np.eye(N)[action]], -1)
    guess = dense(q["forward"], np.maximum(0, dense(q["forward_hidden"], acted)))
    chosen = np.take_along_axis(log_probs, action[..., None], -1)[..., 0]
    return -chosen, 0.5 * ((guess - after) ** 2).sum(-1)


def test_curiosity_is_the_formula():
    assert isinstance(ICM, Rewarding)
    variables = variables_of(ICM, output_of(), BATCH.observation)
    inverse, forward = numpy_icm(variables["params"], OBSERVATION, NEXT, ACTION)
    value, parts = jax.jit(lambda v: ICM(output_of(), BATCH, PROGRESS, v))(variables)
    assert float(parts["inverse"]) == pytest.approx(inverse[INSIDE].mean(), rel=1e-4)
    assert float(parts["forward"]) == pytest.approx(forward[INSIDE].mean(), rel=1e-4)
    expected = 0.8 * inverse[INSIDE].mean() + 0.2 * forward[INSIDE].mean()
    assert float(value) == pytest.approx(expected, rel=1e-4)
    reward, after = jax.jit(lambda v: ICM.reward(v, trajectory(), None))(variables)
    np.testing.assert_allclose(reward, 0.5 * forward * INSIDE, rtol=1e-4)
    assert jax.tree.structure(after) == jax.tree.structure(variables)


def numpy_rnd(variables, observation, mean, variance):
    seen = {**observation, "x": np.clip((observation["x"] - mean) / np.sqrt(variance), -5, 5)}
    target, p = variables["target"], variables["params"]
    expected = dense(target["layers_1"], encode(target["layers_0"], seen))
    hidden = encode(p["layers_0"], seen)
    for layer in ("layers_1", "layers_3"):
        hidden = np.maximum(0, dense(p[layer], hidden))
    return ((dense(p["layers_5"], hidden) - expected) ** 2).mean(-1)


def fresh_rnd():
    assert isinstance(RND, Rewarding)
    variables = variables_of(RND, output_of(), BATCH.observation)
    statistics = {"observation": {"x": Moments.of_none(4)}, "return": Moments.of_none()}
    return {**variables, "statistics": statistics}


def test_random_network_distillation_is_the_formula():
    """The reward takes in the statistics of the observations first, the loss leaves them alone."""
    reward, after = jax.jit(lambda v: RND.reward(v, trajectory(), None))(fresh_rnd())
    mean, variance = NEXT["x"].mean((0, 1)), NEXT["x"].var((0, 1))
    error = numpy_rnd(after, NEXT, mean, variance) * INSIDE
    sums = np.zeros((T + 1, B))
    for t in range(T):
        sums[t + 1] = 0.9 * sums[t] + error[t]
    np.testing.assert_allclose(reward, error / sums[1:].std(), rtol=1e-3)
    value, _ = jax.jit(lambda v: RND(output_of(), BATCH, PROGRESS, v))(after)
    assert float(value) == pytest.approx(
        numpy_rnd(after, OBSERVATION, mean, variance).mean(), rel=1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize("loss", [ICM, RND], ids=["curiosity", "distillation"])
def test_lanes_may_be_on_any_number_of_devices(loss):
    variables = fresh_rnd() if loss is RND else variables_of(ICM, output_of(), BATCH.observation)
    params = variables.pop("params")

    def of_params(output, batch, progress, params):
        return loss(output, batch, progress, {**variables, "params": params})

    assert_same_on_two_devices(of_params, output_of(), BATCH, params)


def test_statistics_are_those_of_all_devices_and_of_all_that_was_seen():
    stream = [2.0 * normal(i, T, B, 3) + i for i in range(4)]
    alone = Moments.of_none(3)
    shared = jax.tree.map(lambda x: jnp.stack([x, x]), alone)
    update = jax.vmap(lambda m, x: m.update(x, "devices"), (0, 2), axis_name="devices")
    for values in stream:
        alone = alone.update(jnp.asarray(values), None)
        shared = update(shared, jnp.asarray(values.reshape(T, B // 2, 2, 3)))
    everything = np.concatenate(stream).reshape(-1, 3)
    for moments in (
        alone,
        jax.tree.map(lambda x: x[0], shared),
        jax.tree.map(lambda x: x[1], shared),
    ):
        assert float(moments.count) == len(everything)
        np.testing.assert_allclose(moments.mean, everything.mean(0), rtol=1e-4)
        np.testing.assert_allclose(moments.variance, everything.var(0), rtol=1e-4)
    scaled = alone.normalize(jnp.asarray(everything))
    np.testing.assert_allclose(scaled.std(0), 1.0, rtol=1e-4)


def test_rewards_are_scaled_by_the_deviation_of_all_their_sums():
    moments, sums = Moments.of_none(), []
    for seed in range(2):
        reward = np.abs(normal(seed, T, B))
        total = np.zeros(B)
        for r in reward:
            total = 0.9 * total + r
            sums.append(total)
        scaled, moments = scale_by_returns(moments, jnp.asarray(reward), 0.9, None)
        np.testing.assert_allclose(scaled, reward / np.std(sums), rtol=1e-4)
