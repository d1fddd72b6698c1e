"""The discriminator's losses and rewards against NumPy; it is the same on any devices."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.losses import GAIL, Rewarding
from jaxact.models import Concatenated, Vector
from jaxact.moments import Moments
from tests.windows import (
    ACTIONS,
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

OBSERVATION = {"x": normal(0, T, B, 4)}
POLICY = GAIL(action_space=ACTIONS, encoder=Concatenated({"x": Vector((5,))}), hidden=7)
EXPERT = dataclasses.replace(POLICY, demonstrations=True)
BATCH = batch_of(jax.tree.map(jnp.asarray, OBSERVATION))
ACTION = np.asarray(BATCH.action)
ROLLOUT = trajectory_of(OBSERVATION, ACTION, OBSERVATION, np.zeros((T, B), bool))


@pytest.fixture(scope="module")
def variables():
    statistics = {"return": Moments.of_none()}
    return {**variables_of(POLICY, output_of(), BATCH.observation), "statistics": statistics}


def numpy_logit(p, action=ACTION):
    """The logit, and its gradient by features and action."""
    p = jax.tree.map(np.asarray, p)
    encoder = p["encoder"]["encoders_x"]["Dense_0"]
    features = np.tanh(OBSERVATION["x"] @ encoder["kernel"] + encoder["bias"])
    x = np.concatenate([features, np.eye(N)[action]], -1)
    layers, slope = p["discriminator"], np.eye(x.shape[-1])
    for name in ("layers_0", "layers_2"):
        x = np.tanh(x @ layers[name]["kernel"] + layers[name]["bias"])
        slope = (slope @ layers[name]["kernel"]) * (1 - x**2)[..., None, :]
    slope = slope @ layers["layers_4"]["kernel"]
    return (x @ layers["layers_4"]["kernel"] + layers["layers_4"]["bias"])[..., 0], slope[..., 0]


def test_losses_are_the_cross_entropies_of_either_side(variables):
    logit, slope = numpy_logit(variables["params"])
    d = 1 / (1 + np.exp(-logit))
    expected = [(-np.log(d).mean(), logit > 0), (-np.log(1 - d).mean(), logit < 0)]

    @jax.jit
    def both(variables):
        penalised = [dataclasses.replace(side, gradient_penalty=10.0) for side in (EXPERT, POLICY)]
        return [side(output_of(), BATCH, PROGRESS, variables) for side in penalised]

    for (total, parts), (value, right) in zip(both(variables), expected, strict=True):
        assert float(parts["cross_entropy"]) == pytest.approx(value, rel=1e-4)
        assert float(parts["accuracy"]) == pytest.approx(right.mean(), rel=1e-5)
        penalty = 0.5 * (slope**2).sum(-1).mean()
        assert float(total) == pytest.approx(value + 10.0 * penalty, rel=1e-4)


def test_rewards_are_those_of_passing_as_a_demonstrator(variables):
    assert isinstance(POLICY, Rewarding)
    logit, _ = numpy_logit(variables["params"])
    raw = dataclasses.replace(POLICY, logit_reward=True, discount=0.0)
    (positive, _), (scaled, after) = jax.jit(
        lambda v: [loss.reward(v, ROLLOUT, None) for loss in (POLICY, raw)]
    )(variables)
    np.testing.assert_allclose(positive, -np.log(1 - 1 / (1 + np.exp(-logit))), rtol=1e-3)
    np.testing.assert_allclose(scaled, logit / logit.std(), rtol=1e-3)
    assert float(after["statistics"]["return"].count) == T * B


@pytest.mark.slow
def test_lanes_may_be_on_any_number_of_devices(variables):
    statistics = variables["statistics"]

    def of_params(output, batch, progress, params):
        penalised = dataclasses.replace(POLICY, gradient_penalty=1.0)
        return penalised(output, batch, progress, {"params": params, "statistics": statistics})

    assert_same_on_two_devices(of_params, output_of(), BATCH, variables["params"])
