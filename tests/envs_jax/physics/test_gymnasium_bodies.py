"""Gymnasium's MuJoCo environments, stepped by MJX, beside Gymnasium's own, stepped by MuJoCo in C.

Both begin in one state and are given the same actions. C computes in float64 and MJX in float32, so
what they say differs by rounding, and where motion is chaotic that grows: the double pendulum is
compared while it has not, and what falls on its feet in every step anew.
"""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.physics.catalogue import BODIES
from envs_jax.physics.environment import PhysicsState
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
    pomdp, state, observation, peer = _begun(name)
    step = jax.jit(pomdp.step)
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


# Steps that begin where Gymnasium's body stands then. Of the greatest difference in each step, what
# nineteen of twenty are to be within, and all: single ones in which a foot comes down differ by
# more. Forces from outside, which may be some hundred, are held to a share of themselves.
LEGS = {"Ant": (1e-3, 0.2), "Humanoid": (1e-3, 0.5)}
_FORCES = 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("name", LEGS)
def test_bodies_with_legs_step_as_gymnasiums(name):
    pomdp, state, observation, peer = _begun(name)
    step = jax.jit(pomdp.step)
    np.testing.assert_allclose(observation["joints"], peer._get_obs(), atol=1e-5)
    space = pomdp.action_space
    assert space.shape == peer.action_space.shape
    bounds = peer.action_space.low.min(), peer.action_space.high.max()
    assert (space.low, space.high) == pytest.approx(bounds)
    generator = np.random.default_rng(0)
    seen, paid, touched = [], [], 0
    forces = 6 * (peer.model.nbody - 1)
    for _ in range(100):
        state = replace(state, environment=_standing(state.environment, peer))
        action = generator.uniform(-0.3, 0.3, space.shape).astype(np.float32) * space.high
        state, ours = step(jax.random.key(0), state, jnp.asarray(action))
        theirs, reward, terminated, _, _ = peer.step(action)
        off = np.abs(np.asarray(ours.observation["joints"]) - theirs)
        off[-forces:] /= np.maximum(np.abs(theirs[-forces:]), 1.0) * _FORCES / LEGS[name][0]
        seen.append(off.max())
        paid.append(abs(float(ours.reward) - reward))
        assert bool(ours.terminated) == terminated
        touched += bool(np.abs(theirs[-forces:]).max() > 0.5)
    assert touched > 30
    assert np.quantile(seen, 0.95) < LEGS[name][0]
    assert max(seen) < LEGS[name][1]
    assert max(paid) < 2e-3
    assert not ours.metrics["diverged"]


@pytest.mark.parametrize("name", LEGS)
def test_bodies_with_legs_are_paid_by_the_rules(name):
    """From made-up states, with Gymnasium's formulas in NumPy; the reading has its order."""
    pomdp = envs_jax.make(f"Physics-{name}-v0")
    world, model = pomdp.environment, pomdp.environment.model
    generator = np.random.default_rng(0)
    sizes = {
        "cinert": (model.nbody, 10),
        "cvel": (model.nbody, 6),
        "qfrc_actuator": (model.nv,),
        "cfrc_ext": (model.nbody, 6),
        "subtree_com": (model.nbody, 3),
    }

    def state(height):
        position = generator.normal(size=model.nq)
        position[2] = height
        numbers = {"position": position, "velocity": generator.normal(size=model.nv)}
        numbers["body_position"] = generator.normal(size=(model.nbody, 3))
        empty = dict.fromkeys((x.name for x in fields(PhysicsState)), jnp.zeros(0))
        extras = {x: 3 * generator.normal(size=sizes[x]) for x in world.extras}
        made = {x: jnp.asarray(y, jnp.float32) for x, y in numbers.items()}
        kept = {x: jnp.asarray(y, jnp.float32) for x, y in extras.items()}
        diverged = jnp.bool_(False)
        return (
            PhysicsState(**empty | made | {"extras": kept, "diverged": diverged}),
            extras,
            numbers,
        )

    for height, is_well in ((0.5, name == "Ant"), (1.5, name == "Humanoid"), (2.5, False)):
        (before, _, old), (after, extras, new) = state(1.0), state(height)
        action = generator.uniform(-0.4, 0.4, model.nu).astype(np.float32)
        _, outcome = pomdp.task.step(jnp.float32(0), before, jnp.asarray(action), after)
        forces = extras["cfrc_ext"]
        if name == "Ant":
            gone = new["body_position"][1, 0] - old["body_position"][1, 0]
            forces = np.clip(forces, -1, 1)
            weights = 1.0, 0.5, 1.0
            contact = 5e-4 * np.sum(forces**2)
        else:
            gone = extras["subtree_com"][0, 0] - float(before.extras["subtree_com"][0, 0])
            weights = 1.25, 0.1, 5.0
            contact = min(5e-7 * np.sum(forces**2), 10.0)
        expected = {
            "forward": weights[0] * gone / world.dt,
            "control": -weights[1] * np.sum(action**2),
            "contact": -contact,
            "healthy": weights[2] * is_well,
        }
        assert outcome.reward.keys() == expected.keys()
        for term, value in expected.items():
            np.testing.assert_allclose(outcome.reward[term], value, rtol=1e-4)
        assert bool(outcome.terminated) == (not is_well)
    order = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext")
    parts = [new["position"][2:], new["velocity"]]
    parts += [
        (
            extras[x][6:]
            if x == "qfrc_actuator"
            else forces[1:]
            if x == "cfrc_ext"
            else extras[x][1:]
        )
        for x in order
        if x in extras
    ]
    reading = pomdp.sensors["joints"].observe(after, None)
    np.testing.assert_allclose(reading, np.concatenate([x.ravel() for x in parts]), rtol=1e-5)
    assert reading.shape == pomdp.sensors["joints"].space.shape


def _standing(state, peer):
    """Returns a state with joints, and all that rewards compare with, where a peer's body is."""
    data, model = peer.data, peer.model

    def floats(x):
        return jnp.asarray(x, jnp.float32)

    extras = dict(state.extras)
    if "subtree_com" in extras:
        # As Gymnasium has it: of the whole, from where bodies were when C last looked.
        mass = model.body_mass[:, None]
        whole = np.sum(mass * data.xipos, axis=0) / np.sum(mass)
        extras["subtree_com"] = extras["subtree_com"].at[0].set(floats(whole))
    return replace(
        state,
        position=floats(data.qpos),
        velocity=floats(data.qvel),
        warm_start=floats(data.qacc_warmstart),
        body_position=floats(data.xpos),
        extras=extras,
    )


def _begun(name):
    """Returns a POMDP, the beginning of an episode, and Gymnasium's body where that has its own."""
    pomdp = envs_jax.make(f"Physics-{name}-v0")
    state, observation = jax.jit(pomdp.reset)(jax.random.key(0))
    peer = gymnasium.make(f"{name}-v5").unwrapped
    peer.reset(seed=0)
    joints = state.environment.position, state.environment.velocity
    peer.set_state(*(np.asarray(x, float) for x in joints))
    return pomdp, state, observation, peer


def test_horizons_are_gymnasiums():
    assert set(BODIES) == set(BOUNDS) | set(LEGS)
    for name, body in BODIES.items():
        assert body.horizon == gymnasium.spec(f"{name}-v5").max_episode_steps


@pytest.mark.slow
@pytest.mark.parametrize("name", ["InvertedPendulum", "Hopper", "Ant"])
def test_a_body_is_sound(name):
    check_pomdp(envs_jax.make(f"Physics-{name}-v0", horizon=20), lanes=2, steps=4)
