"""Worlds behind Brax's interface: the steps of the world itself, and training by Brax's PPO."""

import dataclasses
import functools
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from jaxact import JaxactError
from jaxact.spaces import Box
from tests.corridor import corridor
from tests.point import Anywhere, Plane, point
from tests.simulated import countdown
from tests.tiny import assert_same

POMDP = point()


@pytest.fixture(scope="module")
def adapter():
    """The module, which is not imported while tests are collected: with Brax it takes seconds."""
    return importlib.import_module("jaxact.brax_adapter")


@pytest.fixture(scope="module")
def env(adapter):
    return adapter.to_brax(POMDP)


def test_steps_are_those_of_the_world(env):
    key = jax.random.PRNGKey(1)
    theirs = jax.jit(env.reset)(key)
    reset_key, key = jax.random.split(key)
    state, observation = jax.jit(POMDP.reset)(reset_key)
    assert_same((theirs.pipeline_state, theirs.obs), (state, observation["vector"]))
    step, their_step = jax.jit(POMDP.step), jax.jit(env.step)
    for t in range(14):
        action = jnp.asarray([0.5, -0.1 * t], jnp.float32)
        theirs = their_step(theirs, action)
        step_key, key = jax.random.split(key)
        state, ours = step(step_key, state, action)
        assert_same(theirs.pipeline_state, state)
        assert_same((theirs.obs, theirs.reward), (ours.observation["vector"], ours.reward))
        assert bool(theirs.done) == bool(ours.finished)
        assert bool(theirs.info["time_out"]) == bool(ours.truncated & ~ours.terminated)
        assert float(theirs.metrics["reward/distance"]) == float(ours.reward_terms["distance"])
        assert float(theirs.metrics["success"]) == float(ours.success & ours.finished)
    assert bool(ours.finished)


def test_sizes(env):
    assert (env.observation_size, env.action_size) == (4, 2)


def test_actions_are_spread_over_the_box(adapter):
    @dataclasses.dataclass(frozen=True)
    class Moved(Plane):
        """An action is where to be."""

        @property
        def action_space(self):
            return Box(-0.5, 1.0, (1, 2))

        def step(self, key, state, action):
            return action[0]

    env = adapter.to_brax(dataclasses.replace(POMDP, environment=Moved()))
    state = env.step(env.reset(jax.random.PRNGKey(0)), jnp.asarray([-1.0, 1.0], jnp.float32))
    np.testing.assert_allclose(state.pipeline_state.environment, [-0.5, 1.0])


def test_horizons_are_truncations_and_episodes_begin_again(adapter):
    """Brax's own end of an episode, after 5 steps, and the world's, after 3."""
    for horizon, episode_length in ((3, 5), (5, 3)):
        far_off = dataclasses.replace(POMDP, sampler=Anywhere(horizon))
        env = adapter.wrap(adapter.to_brax(far_off), episode_length=episode_length)
        state = first = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 8))
        step = jax.jit(env.step)
        for t in range(1, 7):
            # Brax's wrappers rely on the default promotion of dtypes.
            with jax.numpy_dtype_promotion("standard"):
                state = step(state, jnp.zeros((8, 2), jnp.float32))
            # Some begin at their goal, and so terminate at once.
            at_goal = np.asarray(first.obs[:, :2] - first.obs[:, 2:])
            far = np.linalg.norm(at_goal, axis=1) >= 0.15
            assert far.sum() >= 6
            ends = t % 3 == 0
            np.testing.assert_array_equal(np.asarray(state.done)[far], float(ends))
            np.testing.assert_array_equal(np.asarray(state.info["truncation"])[far], float(ends))
            np.testing.assert_array_equal(np.asarray(state.done)[~far], 1.0)
            np.testing.assert_array_equal(np.asarray(state.info["truncation"])[~far], 0.0)
        np.testing.assert_array_equal(state.obs, first.obs)


def test_what_brax_cannot_train_is_refused(adapter, env):
    with pytest.raises(JaxactError, match=r"act with numbers from −1 to 1.*Discrete"):
        adapter.to_brax(corridor())
    markov = next(name for name in envs_jax.ids() if name.startswith("Markov-"))
    with pytest.raises(JaxactError, match="worlds of one agent"):
        adapter.to_brax(envs_jax.make(markov))
    with pytest.raises(JaxactError, match="to_brax needs a POMDP, as of "):
        adapter.to_brax(env)
    with pytest.raises(JaxactError, match="Brax's environments are for worlds in JAX"):
        adapter.to_brax(countdown())
    state = jax.eval_shape(env.reset, jax.random.key(0))
    with pytest.raises(
        JaxactError, match=r"an action is of 2 numbers, but it has the shape \(3,\)"
    ):
        jax.eval_shape(env.step, state, jnp.zeros(3, jnp.float32))
    with pytest.raises(JaxactError, match="from to_brax, not yet wrapped, but got"):
        adapter.wrap(adapter.wrap(env, 10), 10)
    with pytest.raises(JaxactError, match="episode_length of wrap must be at least 1, got 0"):
        adapter.wrap(env, 0)
    with pytest.raises(JaxactError, match="its task sampler"):
        adapter.wrap(env, 10, randomization_fn=lambda system: system)


@pytest.mark.slow
def test_brax_trains_a_policy(adapter, env):
    """One that does not move earns −1.24 in the mean, one that always goes straight 0.86."""
    from brax.training.agents.ppo import networks
    from brax.training.agents.ppo import train as ppo

    adapter.restore_device_put_replicated()
    figures = []
    with jax.numpy_dtype_promotion("standard"):
        ppo.train(
            environment=env,
            wrap_env_fn=adapter.wrap,
            episode_length=12,
            num_timesteps=150_000,
            num_envs=256,
            unroll_length=8,
            batch_size=64,
            num_minibatches=4,
            num_updates_per_batch=4,
            num_resets_per_eval=8,
            learning_rate=1e-3,
            discounting=0.95,
            num_evals=2,
            num_eval_envs=256,
            seed=0,
            network_factory=functools.partial(
                networks.make_ppo_networks,
                policy_hidden_layer_sizes=(32, 32),
                value_hidden_layer_sizes=(32, 32),
            ),
            progress_fn=lambda steps, metrics: figures.append(metrics["eval/episode_reward"]),
        )
    assert figures[-1] > 0.5 > 0.0 > figures[0]
