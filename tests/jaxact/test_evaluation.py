"""Evaluation: every episode once, the same ones for everybody, measured as they ended."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Policy, evaluate_expert, evaluate_policy, evaluation
from jaxact.distributions import Categorical
from jaxact.evaluation import HELD_OUT, Evaluation
from jaxact.models import ActorCriticOutput
from jaxact.pomdp import Episode, TaskSampler
from jaxact.train_state import make_key
from tests.corridor import corridor
from tests.tiny import Undemonstrated

EPISODES = 60


class Drift:
    """Goes right with the probability that its parameters say, and counts its steps."""

    @staticmethod
    def initial_memory(lanes):
        return jnp.zeros(lanes, jnp.int32)

    @staticmethod
    def apply(params, observation, memory, previous_action, is_first):
        del previous_action
        memory = jnp.where(is_first, 0, memory) + 1
        logits = jnp.broadcast_to(jnp.stack([jnp.float32(0), params]), (*is_first.shape, 2))
        return ActorCriticOutput(Categorical(logits), memory.astype(jnp.float32)), memory


POMDP = corridor()
MODEL = Drift()


def policy(logit):
    return Policy(MODEL, jnp.float32(logit), POMDP.action_space)


@pytest.fixture(scope="module")
def starts():
    """The held-out episodes, sampled here again: cell and goal of each."""
    keys = jax.random.split(jax.random.fold_in(make_key(0), HELD_OUT), EPISODES)
    state, _ = jax.vmap(lambda key: POMDP.reset(jax.random.split(key)[0]))(keys)
    return np.asarray(state.environment), np.asarray(state.task)


def test_each_episode_is_played_once_to_its_end(starts):
    """Going right always: those with the goal there succeed after as many steps as it is away."""
    cell, goal = starts
    outcome = evaluate_policy(POMDP, policy(50.0), EPISODES)
    np.testing.assert_array_equal(outcome.success, goal == 5)
    length = np.where(goal == 5, 5 - cell, 10)
    np.testing.assert_array_equal(outcome.length, length)
    np.testing.assert_allclose(outcome.episode_return, (goal == 5) - 0.01 * length, atol=1e-5)
    np.testing.assert_allclose(outcome.metrics["reward/success"], goal == 5)
    np.testing.assert_allclose(outcome.metrics["reward/step"], -0.01 * length, atol=1e-5)
    np.testing.assert_allclose(outcome.metrics["task/distance"], np.where(goal == 5, 0, 5))


def test_the_expert_solves_all_on_the_shortest_path(starts):
    cell, goal = starts
    outcome = evaluate_expert(POMDP, EPISODES)
    assert outcome.success.all()
    np.testing.assert_array_equal(outcome.length, np.abs(goal - cell))


def test_the_same_seed_gives_the_same_numbers():
    one, again, other = (evaluate_policy(POMDP, policy(0.0), EPISODES, seed=s) for s in (0, 0, 1))
    np.testing.assert_array_equal(one.length, again.length)
    np.testing.assert_array_equal(one.episode_return, again.episode_return)
    assert not np.array_equal(one.length, other.length)


def test_greedy_takes_the_mode():
    """A policy that hardly prefers right goes right always, if it is greedy."""
    greedy = evaluate_policy(POMDP, policy(0.01), EPISODES, greedy=True)
    always = evaluate_policy(POMDP, policy(50.0), EPISODES)
    sampled = evaluate_policy(POMDP, policy(0.01), EPISODES)
    np.testing.assert_array_equal(greedy.length, always.length)
    assert not np.array_equal(greedy.length, sampled.length)


def test_playing_in_turns_changes_nothing(monkeypatch):
    together = evaluate_policy(POMDP, policy(0.5), 50)
    monkeypatch.setattr(evaluation, "MAX_LANES", 16)  # four turns of 13, with two played twice
    in_turns = evaluate_policy(POMDP, policy(0.5), 50)
    np.testing.assert_array_equal(together.length, in_turns.length)
    np.testing.assert_array_equal(together.success, in_turns.success)
    assert len(in_turns.metrics["task/distance"]) == 50


@dataclasses.dataclass(frozen=True)
class Listing(TaskSampler):
    """Starts one after another, at the end of whose corridor the goal is."""

    starts: tuple[int, ...] = (4, 1, 2, 4, 3)

    @property
    def count(self):
        return len(self.starts)

    def sample(self, key, sampler_state):
        return self.listed(jax.random.randint(key, (), 0, self.count), sampler_state)

    def listed(self, index, sampler_state):
        del sampler_state
        return Episode(jnp.array(self.starts, jnp.int32)[index], jnp.int32(5), jnp.int32(10))


@pytest.mark.parametrize(("episodes", "played"), [(1000, 5), (3, 3)])
def test_a_list_of_episodes_is_played_once_in_order(episodes, played, monkeypatch):
    """Whatever the seed, in one turn or several, and from the beginning if not all are asked."""
    monkeypatch.setattr(evaluation, "MAX_LANES", 4)
    pomdp = dataclasses.replace(POMDP, sampler=Listing())
    outcome = evaluate_expert(pomdp, episodes, seed=episodes)
    assert outcome.length.tolist() == [1, 4, 3, 1, 2][:played]
    assert outcome.success.shape == (played,)


def test_summaries_have_means_and_intervals():
    success = np.array([True] * 8 + [False] * 2)
    values = np.array([1, 2, 3, 1, 2, 3, 1, 2, 3, 2], np.float32)
    summary = Evaluation(success, values, values.astype(np.int32), {"task/x": values}).summary()
    assert summary["episodes"] == 10
    assert summary["success"]["mean"] == 0.8
    # Wilson's interval, as published for 8 of 10.
    assert summary["success"]["interval"] == pytest.approx([0.4902, 0.9433], abs=1e-4)
    assert summary["return"]["mean"] == pytest.approx(2.0)
    half = 2.262157 * values.std(ddof=1) / np.sqrt(10)  # t with 9 degrees of freedom
    assert summary["return"]["interval"] == pytest.approx([2 - half, 2 + half], abs=1e-5)
    assert summary.keys() == {"episodes", "success", "return", "length", "task/x"}


def test_there_may_be_no_expert():
    pomdp = dataclasses.replace(POMDP, task=Undemonstrated())
    with pytest.raises(JaxactError, match="Undemonstrated has no expert"):
        evaluate_expert(pomdp, 4)
