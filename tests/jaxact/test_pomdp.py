"""The four parts, composed: what one step does and does not do."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from jaxact import JaxactError
from jaxact.pomdp import Episode, State
from tests.corridor import CellAndGoal, ReachEnd, corridor
from tests.tiny import Undemonstrated

KEY = jax.random.key(0)
LEFT, RIGHT = jnp.int32(0), jnp.int32(1)


def begin(cell, goal=5, horizon=10):
    pomdp = corridor()
    return pomdp, pomdp.begin(Episode(jnp.int32(cell), jnp.int32(goal), jnp.int32(horizon)))


def test_a_step_in_the_middle():
    pomdp, state = begin(2)
    state, step = pomdp.step(KEY, state, RIGHT)
    assert (int(state.environment), int(state.steps), int(state.horizon)) == (3, 1, 10)
    assert (bool(step.terminated), bool(step.truncated), bool(step.success)) == (False,) * 3
    assert float(step.reward) == pytest.approx(-0.01)
    assert step.observation["vector"][3] == 1.0
    assert float(step.metrics["distance"]) == 2.0


def test_reaching_the_goal_terminates():
    pomdp, state = begin(4)
    _, step = pomdp.step(KEY, state, RIGHT)
    assert bool(step.terminated)
    assert bool(step.success)
    assert not bool(step.truncated)
    assert float(step.reward) == pytest.approx(0.99)
    assert {name: float(x) for name, x in step.reward_terms.items()} == pytest.approx(
        {"success": 1.0, "step": -0.01}
    )


def test_the_horizon_truncates_and_both_may_come_at_once():
    pomdp, state = begin(2, horizon=1)
    state, step = pomdp.step(KEY, state, RIGHT)
    assert (bool(step.terminated), bool(step.truncated)) == (False, True)
    assert bool(step.finished)
    pomdp, state = begin(4, horizon=1)
    _, step = pomdp.step(KEY, state, RIGHT)
    assert (bool(step.terminated), bool(step.truncated)) == (True, True)


def test_a_world_never_resets_itself():
    pomdp, state = begin(4, horizon=1)
    for _ in range(3):
        state, step = pomdp.step(KEY, state, RIGHT)
    assert int(state.steps) == 3
    assert int(state.environment) == 5
    assert bool(step.finished)


def test_reset_is_a_function_of_its_key():
    pomdp = corridor()
    keys = jax.random.split(KEY, 64)
    state, observation = jax.vmap(pomdp.reset)(keys)
    again, _ = jax.vmap(pomdp.reset)(keys)
    assert state.environment.tolist() == again.environment.tolist()
    assert len(set(state.environment.tolist())) == 4
    assert set(state.task.tolist()) == {0, 5}
    assert observation["vector"].shape == (64, 12)


def test_parts_can_be_exchanged():
    pomdp, _ = begin(2)
    harsher = dataclasses.replace(pomdp, task=ReachEnd(step_penalty=-1.0))
    _, step = harsher.step(KEY, begin(2)[1], LEFT)
    assert float(step.reward) == -1.0
    seen_twice = dataclasses.replace(pomdp, sensors={"b": CellAndGoal(), "a": CellAndGoal()})
    assert list(seen_twice.observation_space.spaces) == ["a", "b"]
    assert list(seen_twice.observe(begin(2)[1])) == ["a", "b"]


def test_pomdps_are_hashable_and_compare_by_value():
    assert corridor() == corridor()
    assert hash(corridor()) == hash(corridor())
    assert corridor() != corridor(length=7)


def test_the_expert_speaks_for_its_task():
    pomdp, state = begin(2, goal=0)
    advice = pomdp.expert(KEY, state)
    assert (int(advice.action), bool(advice.valid)) == (0, True)
    silent = dataclasses.replace(pomdp, task=Undemonstrated())
    assert not silent.has_expert
    with pytest.raises(JaxactError, match="Undemonstrated has no expert: imitation, teacher"):
        silent.expert(KEY, state)


def test_sensors_that_show_and_say_nothing():
    pomdp, state = begin(2)
    assert pomdp.pictures(state) == {}
    assert pomdp.words(pomdp.observe(state)) == ""
    assert isinstance(state, State)
