"""Harvest and Escalation: what is paid, and when it ends."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import envs_jax
from envs_jax.social.escalation import EscalationState
from envs_jax.social.harvest import Harvest, HarvestState

LEFT, DOWN, RIGHT, UP = range(4)


def test_young_plants_pay_one_and_ripe_ones_all():
    pomdp = envs_jax.make("Markov-Harvest-v0")
    state, _ = pomdp.reset(jax.random.key(0))
    none = jnp.zeros(2, jnp.int32)
    start = HarvestState(
        agents=jnp.int32([[0, 0], [4, 4]]),
        plants=jnp.int32([[1, 0], [3, 4], [2, 2], [0, 4]]),
        ripe=jnp.array([False, True, True, False]),
        young_by=none,
        ripe_by=none,
    )
    after, step = jax.jit(pomdp.step)(
        jax.random.key(1), replace(state, environment=start), jnp.int32([RIGHT, LEFT])
    )
    np.testing.assert_allclose(step.reward_terms["young"], [1.0, 0.0])
    np.testing.assert_allclose(step.reward_terms["ripe"], [2.0, 2.0])
    assert bool(step.success)
    plants = np.asarray(after.environment.plants)
    assert not (plants[:2] == [[1, 0], [3, 4]]).all(-1).any()
    assert len({tuple(p) for p in plants.tolist()}) == 4
    assert not np.asarray(after.environment.ripe)[:2].any()


def test_plants_ripen_and_die_as_often_as_said():
    world = Harvest(ripens=0.2, dies=0.3)
    none = jnp.zeros(2, jnp.int32)
    start = HarvestState(
        agents=jnp.int32([[0, 0], [4, 4]]),
        plants=jnp.int32([[2, 0], [2, 1], [2, 2], [2, 3]]),
        ripe=jnp.array([False, False, True, True]),
        young_by=none,
        ripe_by=none,
    )
    keys = jax.random.split(jax.random.key(0), 5000)
    after = jax.jit(jax.vmap(world.step, (0, None, None)))(keys, start, jnp.int32([UP, DOWN]))
    ripe = np.asarray(after.ripe).mean(0)
    np.testing.assert_allclose(ripe, [0.2, 0.2, 0.7, 0.7], atol=0.035)
    stayed = (np.asarray(after.plants) == np.asarray(start.plants)).all(-1).mean(0)
    assert stayed[0] == stayed[1] == 1.0
    np.testing.assert_allclose(stayed[2:], 0.7, atol=0.035)


def test_a_broken_streak_costs_the_one_who_is_left():
    pomdp = envs_jax.make("Markov-Escalation-v0")
    state, _ = pomdp.reset(jax.random.key(0))
    start = EscalationState(
        agents=jnp.int32([[1, 2], [3, 2]]),
        marker=jnp.int32([2, 2]),
        at_marker=jnp.zeros(2, bool),
        streak=jnp.int32(0),
    )
    state = replace(state, environment=start)
    step = jax.jit(pomdp.step)
    state, first = step(jax.random.key(1), state, jnp.int32([RIGHT, LEFT]))
    np.testing.assert_allclose(first.reward, [1.0, 1.0])
    for t in range(3):
        to = np.asarray(state.environment.marker - state.environment.agents[0])
        move = [(-1, 0), (0, 1), (1, 0), (0, -1)].index(tuple(to.tolist()))
        if t < 2:
            state, result = step(jax.random.key(2 + t), state, jnp.int32([move, move]))
            np.testing.assert_allclose(result.reward, [1.0, 1.0])
            assert not bool(result.terminated)
    away = (move + 2) % 4
    _, last = step(jax.random.key(9), state, jnp.int32([move, away]))
    np.testing.assert_allclose(last.reward, [0.0, -0.5 * 3])
    assert bool(last.terminated)
    assert bool(last.success)
    _, both = step(jax.random.key(9), state, jnp.int32([away, away]))
    np.testing.assert_allclose(both.reward, [0.0, 0.0])
    assert bool(both.terminated)
