"""Worlds behind gymnax's interface: its protocol, and the steps of the world itself."""

import importlib.util
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from jaxact import JaxactError
from jaxact.gymnax_adapter import GymnaxParams, to_gymnax
from tests.corridor import corridor
from tests.tiny import assert_same

POMDP = corridor()
ENV = to_gymnax(POMDP, name="corridor")


def installed(name):
    return pytest.mark.skipif(
        importlib.util.find_spec(name) is None,
        reason=f"{name} is not installed (pip install -e '.[adapters]')",
    )


def play(env, steps=30, **params):
    """Steps from a seed with fixed actions."""
    params = GymnaxParams(**params) if params else env.default_params
    # Libraries for gymnax still make keys of this old kind.
    keys = jax.random.split(jax.random.PRNGKey(1), steps + 1)
    observation, state = env.reset(keys[0], params)
    rows = [(observation, state)]
    for t, key in enumerate(keys[1:]):
        rows.append(env.step(key, rows[-1][1], int(t % 4 > 0), params))
    return keys, rows


def test_steps_are_those_of_the_world_and_reset_at_the_end():
    keys, rows = play(ENV)
    reset, step = jax.jit(POMDP.reset), jax.jit(POMDP.step)
    state, observation = reset(keys[0])
    assert_same(rows[0], (observation, state))
    ends = 0
    for t, (key, row) in enumerate(zip(keys[1:], rows[1:], strict=True)):
        step_key, reset_key = jax.random.split(key)
        state, expected = step(step_key, state, jnp.int32(t % 4 > 0))
        observation = expected.observation
        if bool(expected.finished):
            ends += 1
            state, observation = reset(reset_key)
        flags = {"terminated": expected.terminated, "truncated": expected.truncated}
        info = {**expected.info, **flags, "final_observation": expected.observation}
        assert_same(row, (observation, state, expected.reward, *flags.values(), info))
    assert ends > 2


def test_done_may_be_joint():
    _, rows = play(ENV)
    _, joint = play(to_gymnax(POMDP, joint_done=True))
    assert_same(joint[0], rows[0])
    for one, (*first, terminated, truncated, info) in zip(joint[1:], rows[1:], strict=True):
        assert_same(one, (*first, terminated | truncated, info))


def test_episodes_end_after_the_most_steps_there_may_be():
    _, rows = play(ENV, steps=8, max_steps_in_episode=2)
    for t, (_, state, _, terminated, truncated, _) in enumerate(rows[1:]):
        assert int(state.horizon) == 2
        assert bool(truncated | terminated) or t == 0 or int(rows[t][1].steps) == 0
    assert any(bool(row[4]) for row in rows[1:])


def test_lanes_and_steps_are_mapped_and_scanned():
    env = to_gymnax(envs_jax.make("MiniGrid-Empty-Random-5x5-v0"), flatten=True)

    def train(key):
        observation, state = jax.vmap(env.reset)(jax.random.split(key, 3))

        def step(carry, key):
            _, state = carry
            action = jnp.full(3, 2, jnp.int32)
            observation, state, reward, *_ = jax.vmap(env.step)(
                jax.random.split(key, 3), state, action
            )
            return (observation, state), reward

        return jax.lax.scan(step, (observation, state), jax.random.split(key, 5))

    (observation, _), reward = jax.jit(train)(jax.random.key(0))
    assert reward.shape == (5, 3)
    assert observation.dtype == jnp.float32
    assert observation.ndim == 2


def test_flat_observations_hold_all_readings():
    pomdp = envs_jax.make("MiniGrid-Empty-Random-5x5-v0")
    flat, _ = to_gymnax(pomdp, flatten=True).reset(jax.random.key(3))
    whole, _ = to_gymnax(pomdp).reset(jax.random.key(3))
    assert sorted(whole) == ["direction", "image", "mission"]
    direction, image, mission = np.split(np.asarray(flat), [4, 4 + 147])
    np.testing.assert_array_equal(direction, np.eye(4)[int(whole["direction"])])
    np.testing.assert_array_equal(image, np.ravel(whole["image"]))
    np.testing.assert_array_equal(mission, np.ravel(whole["mission"]))


def test_without_gymnax_there_are_no_spaces_but_all_else(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnax", None)
    monkeypatch.setitem(sys.modules, "gymnax.environments", None)
    env = to_gymnax(corridor(length=4), name="short")
    assert (env.name, env.num_actions) == ("short", 2)
    env.step(jax.random.key(1), env.reset(jax.random.key(0))[1], 1)
    for space in (env.action_space, env.observation_space):
        with pytest.raises(JaxactError, match="not installed"):
            space(env.default_params)


@installed("gymnax")
def test_spaces_are_gymnaxs():
    from gymnax.environments import spaces

    pomdp = envs_jax.make("MiniGrid-Empty-Random-5x5-v0")
    env = to_gymnax(pomdp)
    assert isinstance(env.action_space(env.default_params), spaces.Discrete)
    assert env.action_space().n == env.num_actions == 7
    image = env.observation_space(env.default_params).spaces["image"]
    assert (image.shape, image.dtype, image.low, image.high) == ((7, 7, 3), jnp.uint8, 0, 255)
    env = to_gymnax(pomdp, flatten=True)
    space = env.observation_space(env.default_params)
    observation, _ = env.reset(jax.random.key(0))
    assert (observation.shape, observation.dtype) == (space.shape, space.dtype)
    assert bool(space.contains(observation))


@installed("gymnax")
def test_gymnaxs_own_wrappers_wrap_it():
    from gymnax.wrappers.purerl import LogWrapper

    env = LogWrapper(ENV)
    params = env.default_params
    key = jax.random.key(0)
    _, state = env.reset(key, params)
    lengths = set()
    with jax.numpy_dtype_promotion("standard"):
        for t in range(30):
            _, state, *_, info = env.step(jax.random.fold_in(key, t), state, 1, params)
            lengths.add(int(info["returned_episode_lengths"]))
    assert lengths <= {0, 1, 2, 3, 4, 10}
    assert len(lengths) > 2


@pytest.mark.slow
@installed("rejax")
def test_rejax_learns():
    with warnings.catch_warnings(), jax.numpy_dtype_promotion("standard"):
        warnings.simplefilter("ignore")
        from rejax import PPO

        algorithm = PPO.create(
            env=to_gymnax(POMDP, flatten=True, joint_done=True),
            total_timesteps=8_192,
            eval_freq=4_096,
            num_envs=16,
            num_steps=32,
            num_minibatches=4,
            learning_rate=3e-3,
        )
        _, (lengths, returns) = jax.jit(algorithm.train)(jax.random.PRNGKey(0))
    assert lengths.shape == (3, 128)
    # The shortest paths are of 2.5 steps on average, at 0.01 each.
    assert returns[0].mean() < 0.8
    assert returns[-1].mean() > 0.95
