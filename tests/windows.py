"""A window of random steps with episodes that begin in it, for the tests of losses."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.distributions import Categorical
from jaxact.losses import Batch, Progress
from jaxact.models import ActorCriticOutput
from jaxact.spaces import Discrete

T, B, F, H, N = 11, 4, 5, 6, 3
ACTIONS = Discrete(N)
PROGRESS = Progress(jnp.float32(0.0), jnp.float32(0.0))
IS_FIRST = np.zeros((T, B), bool)
IS_FIRST[[0, 8, 3, 4, 10], [0, 0, 1, 1, 3]] = True


def normal(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def batch_of(observation=None, is_first=IS_FIRST, action=None, axis_name=None):
    """A batch of which losses that are no policy gradients can see something."""
    zeros, flags = jnp.zeros(is_first.shape, jnp.float32), jnp.zeros(is_first.shape, bool)
    if action is None:
        action = np.random.default_rng(7).integers(0, N, is_first.shape)
    return Batch(
        observation=observation or {},
        previous_action=flags.astype(jnp.int32),
        is_first=jnp.asarray(is_first),
        memory=(),
        action=jnp.asarray(action, jnp.int32),
        log_prob=zeros,
        value=zeros,
        reward=zeros,
        reward_terms={},
        terminated=flags,
        truncated=flags,
        advantage=zeros,
        normalized_advantage=zeros,
        returns=zeros,
        expert=None,
        key=jax.random.split(jax.random.key(0), is_first.shape[1]),
        axis_name=axis_name,
    )


def trajectory_of(observation, action, after, finished):
    """What a loss that rewards sees of a rollout."""
    step = SimpleNamespace(
        observation=jax.tree.map(jnp.asarray, after), finished=jnp.asarray(finished)
    )
    return SimpleNamespace(
        observation=jax.tree.map(jnp.asarray, observation),
        action=jnp.asarray(action, jnp.int32),
        step=step,
    )


def output_of(shape=(T, B), **extras):
    zeros = jnp.zeros(shape, jnp.float32)
    extras = {name: jax.tree.map(jnp.asarray, x) for name, x in extras.items()}
    return ActorCriticOutput(Categorical(jnp.zeros((*shape, N), jnp.float32)), zeros, extras)


def variables_of(loss, output, observation=None, seed=0):
    """Random variables of a loss: initialisers take seconds to compile."""
    one = jax.tree.map(lambda x: x[0, :1], output)
    observation = jax.tree.map(lambda x: jnp.zeros_like(x[0, :1]), observation or {})
    shapes = jax.eval_shape(
        lambda key: loss.init(key, one, observation, jnp.zeros(1, jnp.int32)), jax.random.key(0)
    )
    leaves, structure = jax.tree.flatten(shapes)
    random = [0.5 * normal(seed + i, *x.shape) for i, x in enumerate(leaves)]
    return structure.unflatten([jnp.asarray(x) for x in random])


def assert_same_on_two_devices(loss, output, batch, variables):
    """Two devices' mean value and gradient are those on one with all lanes."""

    def graded(variables, output, batch):
        def value(variables):
            return loss(output, batch, PROGRESS, variables)[0]

        return jax.value_and_grad(value)(variables)

    def share(index):
        def half(x):
            return x[:, 2 * index : 2 * index + 2]

        split = dataclasses.replace(batch, memory=(), key=batch.key[None])
        split = dataclasses.replace(jax.tree.map(half, split), axis_name="devices")
        return jax.tree.map(half, output), dataclasses.replace(split, key=split.key[0])

    shares = jax.tree.map(lambda *x: jnp.stack(x), share(0), share(1))
    on_two = jax.vmap(graded, (None, 0, 0), axis_name="devices")
    halves = jax.jit(on_two)(variables, *shares)
    whole = jax.jit(graded)(variables, output, batch)
    for two, one in zip(jax.tree.leaves(halves), jax.tree.leaves(whole), strict=True):
        np.testing.assert_allclose(two.mean(0), one, rtol=1e-4, atol=1e-6)
    assert float(whole[0]) != pytest.approx(0.0, abs=1e-3)
