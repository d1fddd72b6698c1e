"""Gymnasium's MuJoCo environments, stepped by MJX, beside Gymnasium's own, stepped by MuJoCo in C.

Both begin in one state and are given the same actions. C computes in float64 and MJX in float32, so
what they say differs by rounding, and where motion is chaotic that grows: the double pendulum is
compared while it has not.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.physics.catalogue import BODIES
from jaxact.testing import check_pomdp

gymnasium = pytest.importorskip("gymnasium")

# Steps, and the greatest differences of an observation's number and of a reward. Those that were
# seen are a tenth to a third of these.
BOUNDS = {
    "InvertedPendulum": (100, 1e-4, 1e-6),
    "InvertedDoublePendulum": (30, 3e-4, 3e-4),
    "Reacher": (100, 1e-4, 1e-6),
    "Swimmer": (100, 3e-5, 3e-6),
    "HalfCheetah": (100, 3e-4, 3e-5),
    "Hopper": (100, 1e-4, 3e-5),
    "Walker2d": (100, 1e-3, 3e-4),
}


@pytest.mark.parametrize(
    "name",
    [
        "InvertedPendulum",
        *(pytest.param(name, marks=pytest.mark.slow) for name in list(BOUNDS)[1:]),
    ],
)
def test_bodies_move_and_are_paid_as_gymnasiums(name):
    steps, seen, paid = BOUNDS[name]
    pomdp = envs_jax.make(f"Physics-{name}-v0")
    state, observation = jax.jit(pomdp.reset)(jax.random.key(0))
    step = jax.jit(pomdp.step)
    peer = gymnasium.make(f"{name}-v5").unwrapped
    peer.reset(seed=0)
    peer.set_state(*(np.asarray(x, float) for x in _joints(state)))
    np.testing.assert_allclose(observation["joints"], peer._get_obs(), atol=seen)
    space = pomdp.action_space
    assert (space.low, space.high) == (peer.action_space.low.min(), peer.action_space.high.max())
    assert space.shape == peer.action_space.shape
    generator = np.random.default_rng(0)
    moved = 0.0
    for _ in range(steps):
        action = generator.uniform(-0.3, 0.3, space.shape).astype(np.float32)
        state, ours = step(jax.random.key(0), state, jnp.asarray(action))
        theirs, reward, terminated, _, _ = peer.step(action)
        np.testing.assert_allclose(ours.observation["joints"], theirs, atol=seen)
        np.testing.assert_allclose(ours.reward, reward, atol=paid)
        assert bool(ours.terminated) == terminated
        moved = max(moved, float(np.ptp(theirs - observation["joints"])))
    assert moved > 0.1
    assert not ours.metrics["diverged"]


def _joints(state):
    return state.environment.position, state.environment.velocity


def test_horizons_are_gymnasiums():
    assert set(BODIES) == set(BOUNDS)
    for name, body in BODIES.items():
        assert body.horizon == gymnasium.spec(f"{name}-v5").max_episode_steps


@pytest.mark.slow
def test_a_body_is_sound():
    check_pomdp(envs_jax.make("Physics-InvertedPendulum-v0", horizon=20), lanes=2, steps=4)
