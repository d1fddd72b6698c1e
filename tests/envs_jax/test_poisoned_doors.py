"""PoisonedDoors: what each door is worth, and what becomes of those who imitate the expert."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.poisoned_doors import COMBINATION, DONE, NEXT_SYMBOL, DoorsState, StageSensor
from jaxact.testing import check_pomdp

POMDP = envs_jax.make("Advisor-PoisonedDoors-v0")
STEP = jax.jit(POMDP.step)
LOCK = 3


def play(good, actions):
    """The last state, and every step, of an episode whose good door is `good`."""
    state, _ = POMDP.reset(jax.random.key(0))
    state, steps = replace(state, task=jnp.int32(good)), []
    for action in actions:
        state, step = STEP(jax.random.key(1), state, jnp.int32(action))
        steps.append(step)
    return state, steps


def test_the_world_is_sound():
    check_pomdp(POMDP)
    assert POMDP.action_space.n == 7
    assert len(POMDP.environment.action_names) == 7


@pytest.mark.parametrize("good", [1, 2, 3])
@pytest.mark.parametrize("door", [1, 2, 3])
def test_doors_are_good_or_poisoned(good, door):
    _, (wait, step) = play(good, [0, LOCK + door])
    assert (float(wait.reward), bool(wait.terminated)) == (0.0, False)  # symbols do nothing yet
    assert float(step.reward) == (2.0 if door == good else -2.0)
    assert bool(step.success) == (door == good)
    assert bool(step.terminated)
    assert float(step.metrics["chose_good_door"]) == (door == good)


def test_the_whole_combination_opens_the_lock():
    assert len(COMBINATION) == 10
    _, steps = play(2, [LOCK, *COMBINATION])
    assert [float(step.reward) for step in steps] == [0.0] * 10 + [1.0]
    assert [bool(step.terminated) for step in steps] == [False] * 10 + [True]
    assert bool(steps[-1].success)
    stages = [int(jnp.argmax(step.observation["stage"])) for step in steps]
    assert stages == [1, *[2] * 9, 3]


@pytest.mark.parametrize("mistake", [1, LOCK, LOCK + 2])
def test_a_mistake_at_the_lock_ends_it_without_reward(mistake):
    """Another symbol, the lock again, or the good door: too late."""
    state, steps = play(2, [LOCK, COMBINATION[0], mistake])
    assert COMBINATION[1] != mistake
    assert [float(step.reward) for step in steps] == [0.0] * 3
    assert bool(steps[-1].terminated)
    assert not steps[-1].success
    assert float(steps[-1].metrics["symbols_entered"]) == 1.0
    # Nothing moves any more.
    after, step = STEP(jax.random.key(0), state, jnp.int32(LOCK + 2))
    assert int(after.environment.stage) == DONE
    assert float(step.reward) == 0.0


def test_the_expert_knows_the_good_door_and_the_combination():
    keys = jax.random.split(jax.random.key(0), 3000)
    states, _ = jax.jit(jax.vmap(POMDP.reset))(keys)
    shares = np.bincount(np.asarray(states.task), minlength=4) / len(keys)
    np.testing.assert_allclose(shares, [0, *[1 / 3] * 3], atol=0.04)
    assert set(np.asarray(states.horizon).tolist()) == {100}
    expert = jax.jit(jax.vmap(POMDP.expert))
    advice = expert(keys, states)
    assert bool(jnp.all(advice.valid))
    _, steps = jax.vmap(STEP)(keys, states, advice.action)
    assert set(np.asarray(steps.reward).tolist()) == {2.0}
    # Its choice by another who cannot know: 2 · (1/3 − 2/3).
    _, steps = jax.vmap(STEP)(keys, states, jnp.roll(advice.action, 1))
    assert float(steps.reward.mean()) == pytest.approx(-2 / 3, abs=0.15)
    state, _ = play(1, [LOCK, *COMBINATION[:4]])
    assert int(POMDP.expert(keys[0], state).action) == COMBINATION[4]
    state, _ = play(1, [LOCK + 1])
    assert not POMDP.expert(keys[0], state).valid


def test_picture_shows_the_good_door_and_what_was_entered():
    state = DoorsState(jnp.int32(NEXT_SYMBOL), jnp.int32(0), jnp.int32(5))
    frame = np.asarray(StageSensor().picture(state, jnp.int32(2)))
    assert frame.shape == (92, 160, 3)
    assert frame.dtype == np.uint8
    assert frame[0, ::40].tolist() == [[180] * 3, [75, 45, 20], [0, 127, 0], [75, 45, 20]]
    assert np.sum(frame[-1, :, 0] == 180) == 18
