"""Shaped tasks: named terms are added, potentials telescope, the expert and all else stay."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.errors import JaxactError
from jaxact.overrides import numbers, with_numbers
from jaxact.shaping import Potential, Shaped
from tests.corridor import ReachEnd, corridor
from tests.tiny import Undemonstrated

DISCOUNT = 0.9
WORLD = corridor(length=6, horizon=10)


def nearness(state, goal):
    return 1.0 - jnp.abs(goal - state).astype(jnp.float32) / 5.0


def effort(before, action, after, goal, next_goal):
    del action, goal, next_goal
    return jnp.where(before == after, -1.0, 0.0)


def shaped(task=WORLD.task):
    terms = {"nearness": Potential(nearness, DISCOUNT), "effort": effort}
    return dataclasses.replace(WORLD, task=Shaped(task, terms))


@jax.jit
def play(actions):
    """Steps of an episode from cell 2 to cell 5, for as long as there are actions."""
    state, _ = shaped().reset(jax.random.key(0))
    state = dataclasses.replace(state, environment=jnp.int32(2), task=jnp.int32(5))

    def act(state, action):
        state, step = shaped().step(jax.random.key(0), state, action)
        return state, (state.environment, step)

    return jax.lax.scan(act, state, actions)[1]


def discounted(rewards):
    return float(np.sum(np.asarray(rewards) * DISCOUNT ** np.arange(len(rewards))))


@pytest.mark.parametrize("actions", [[1, 1, 1], [0, 1, 1, 0, 1, 1, 1]], ids=["best", "detour"])
def test_a_potential_telescopes_to_what_no_policy_can_change(actions):
    _, step = play(jnp.array(actions, jnp.int32))
    assert np.asarray(step.terminated).tolist() == [False] * (len(actions) - 1) + [True]
    terms = step.reward_terms
    assert discounted(terms["nearness"]) == pytest.approx(-(1 - 3 / 5), abs=1e-6)
    np.testing.assert_allclose(step.reward, sum(np.asarray(x) for x in terms.values()), rtol=1e-6)


def test_where_the_horizon_cuts_the_potential_stays():
    cells, step = play(jnp.array([0] * 10, jnp.int32))
    assert bool(step.truncated[-1])
    assert not bool(step.terminated[-1])
    phi = 1 - np.abs(5 - np.asarray([2, *cells])) / 5
    expected = DISCOUNT * phi[1:] - phi[:-1]
    np.testing.assert_allclose(step.reward_terms["nearness"], expected, atol=1e-6)


def test_the_best_policy_stays_the_best():
    """Q-values by backward induction: shaping takes Φ(s) from all of a state's alike."""
    goal = jnp.int32(5)

    def values(task):
        cells, actions = jnp.arange(6, dtype=jnp.int32), jnp.arange(2, dtype=jnp.int32)

        def outcome(cell, action):
            after = WORLD.environment.step(jax.random.key(0), cell, action)
            _, judged = task.step(goal, cell, action, after)
            return after, sum(judged.reward.values()), judged.terminated

        every = jax.jit(jax.vmap(jax.vmap(outcome, (None, 0)), (0, None)))(cells, actions)
        after, reward, terminated = (np.asarray(x) for x in every)
        v = np.zeros(6)
        for _ in range(100):
            q = reward + np.where(terminated, 0.0, DISCOUNT * v[after])
            v = q.max(1)
        return q

    terms = {"nearness": Potential(nearness, DISCOUNT)}
    plain, other = values(ReachEnd()), values(Shaped(ReachEnd(), terms))
    phi = np.asarray(jax.vmap(nearness, (0, None))(jnp.arange(6, dtype=jnp.int32), goal))
    np.testing.assert_allclose(other[:5], plain[:5] - phi[:5, None], atol=1e-5)
    assert (other[:5].argmax(1) == plain[:5].argmax(1)).all()


def test_the_terms_are_added_and_the_rest_is_the_tasks():
    cells, step = play(jnp.array([0, 0, 0, 1], jnp.int32))
    assert np.asarray(cells).tolist() == [1, 0, 0, 1]
    assert np.asarray(step.reward_terms["effort"]).tolist() == [0.0, 0.0, -1.0, 0.0]
    assert set(step.reward_terms) == {"success", "step", "nearness", "effort"}
    assert np.asarray(step.metrics["distance"]).tolist() == [4.0, 5.0, 5.0, 4.0]


def test_an_expert_passes_through():
    state, _ = WORLD.reset(jax.random.key(3))
    ours, theirs = (pomdp.expert(jax.random.key(0), state) for pomdp in (shaped(), WORLD))
    assert int(ours.action) == int(theirs.action)
    assert bool(ours.valid) == bool(theirs.valid)
    assert shaped().has_expert
    assert not shaped(Undemonstrated()).has_expert


@dataclasses.dataclass(frozen=True)
class Choosy(ReachEnd):
    def check(self, pomdp):
        raise JaxactError("the task needs another world")


def test_what_the_task_refuses_is_refused():
    pomdp = corridor(length=6)
    with pytest.raises(JaxactError, match="the task needs another world"):
        dataclasses.replace(pomdp, task=Shaped(Choosy(), {"none": lambda *_: 0.0}))


def test_it_is_a_dataclass_as_any_other():
    task = shaped().task
    path = "terms.nearness.discount"
    assert numbers(task)[path] == DISCOUNT
    changed = with_numbers(task, {path: 0.5, "task.step_penalty": -1.0})
    assert (changed.terms["nearness"].discount, changed.task.step_penalty) == (0.5, -1.0)
    assert dataclasses.replace(WORLD, task=changed).has_expert
    assert copy.deepcopy(task) == task == dataclasses.replace(task)
    assert hash(task) == hash(shaped().task)


def test_what_cannot_be_shaped():
    with pytest.raises(JaxactError, match="nothing to shape"):
        Shaped(ReachEnd(), {})
    with pytest.raises(JaxactError, match="ReachEnd already has a reward component 'step'"):
        Shaped(ReachEnd(), {"step": effort}).step(*(jnp.int32(x) for x in (5, 1, 1, 2)))
