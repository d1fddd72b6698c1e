"""Losses with variables and rewards of their own, weights of rewards, and stages with storages."""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Stage, make_train
from jaxact.losses import A2C, Batch, Imitation, Loss
from jaxact.pomdp import ExpertAction
from jaxact.program import Program, choose_devices
from jaxact.storages import Storage
from jaxact.train_state import make_key
from tests.tiny import UPDATE, assert_same, experiment


@dataclass(frozen=True)
class Novelty(Loss):
    """Guesses how often each action is taken, counts rollouts, and rewards the first action."""

    size: float = 1.0

    def init(self, key, output, observation, action):
        del key, output, observation
        frequency = jnp.zeros(2, jnp.float32)
        return {"params": {"frequency": frequency}, "statistics": {"rollouts": jnp.int32(0)}}

    def reward(self, variables, trajectory, axis_name):
        del axis_name
        seen = {"rollouts": variables["statistics"]["rollouts"] + 1}
        return self.size * (trajectory.action == 0).astype(jnp.float32), {
            **variables,
            "statistics": seen,
        }

    def __call__(self, output, batch, progress, variables):
        del output, progress
        logits = variables["params"]["frequency"]
        log_prob = jax.nn.log_softmax(logits)[batch.action]
        return -batch.mean(log_prob), {"cross_entropy": -batch.mean(log_prob)}


@dataclass(frozen=True, kw_only=True)
class Rightwards(Storage):
    """Hand-made demonstrations: in every cell, to the right; counts its batches."""

    keeps: ClassVar[frozenset[str]] = frozenset({"expert"})

    def load(self, pomdp):
        return jnp.eye(12, dtype=jnp.float32)

    def init(self, pomdp, model, keys, data):
        return {
            "key": keys,
            "memory": model.initial_memory(self.lanes),
            "batches": jnp.zeros(self.lanes, jnp.int32),
        }

    def batch(self, state, data, axis_name):
        lanes = state["key"].shape[0]
        shape = (self.length, lanes)
        cell = (jnp.arange(self.length, dtype=jnp.int32)[:, None] + state["batches"]) % 6
        action = jnp.ones(shape, jnp.int32)
        batch = Batch(
            observation={"vector": data[cell]},
            previous_action=action,
            is_first=jnp.zeros(shape, bool).at[0].set(state["batches"] == 0),
            memory=state["memory"],
            action=action,
            log_prob=self.not_kept("log_prob"),
            value=self.not_kept("value"),
            reward=jnp.zeros(shape, jnp.float32),
            reward_terms={},
            terminated=jnp.zeros(shape, bool),
            truncated=jnp.zeros(shape, bool),
            advantage=self.not_kept("advantage"),
            normalized_advantage=self.not_kept("normalized_advantage"),
            returns=self.not_kept("returns"),
            expert=ExpertAction(action, jnp.ones(shape, bool)),
            key=state["key"],
            axis_name=axis_name,
        )
        return {**state, "batches": state["batches"] + 1}, batch

    def carry_on(self, state, memory):
        return {**state, "memory": memory}


def stages(**fields):
    """Three updates with everything, then one stage that learns from demonstrations alone."""
    storage = Rightwards(losses={"imitation": Imitation()}, updates=2, lanes=4, length=6)
    everything = {
        "losses": {"a2c": A2C(), "novelty": Novelty()},
        "steps": 3 * UPDATE,
        "weights": {"novelty": 10.0},
        "storages": {"demonstrations": storage},
        "rewards": {"step": 0.0},
    }
    return (
        Stage(**everything | fields),
        Stage(losses={}, steps=3 * storage.steps, storages={"demonstrations": storage}),
    )


@pytest.fixture(scope="module")
def trained():
    small = experiment(stages=stages())
    return jax.jit(make_train(small))(make_key(0), {}, {"demonstrations": jnp.eye(12)})


def test_variables_are_trained_and_kept(trained):
    state, metrics = trained
    assert int(state.losses["novelty"]["statistics"]["rollouts"]) == 3
    assert float(jnp.abs(state.losses["novelty"]["params"]["frequency"]).max()) > 0
    entropy = np.asarray(metrics["losses/novelty/cross_entropy"])
    assert np.all(np.isfinite(entropy[:3]))
    assert entropy[0] == pytest.approx(np.log(2), abs=0.02)


def test_their_rewards_are_logged_and_others_weighted(trained):
    _, metrics = trained
    of_first_action = np.asarray(metrics["train/reward/novelty"])[:3]
    assert np.all((of_first_action > 0) & (of_first_action < 1))
    # What is reported of episodes is the task's own.
    assert np.asarray(metrics["episodes/reward/step"])[:3].sum() < 0


def test_storages_go_on_where_the_stage_before_left_them(trained):
    state, metrics = trained
    assert np.asarray(state.storages["demonstrations"]["batches"]).tolist() == [12] * 4
    assert np.asarray(state.updates).tolist() == [3, 3]
    error = np.asarray(metrics["losses/demonstrations/imitation/cross_entropy"])
    assert error[-1] < error[0]
    assert np.isnan(np.asarray(metrics["losses/a2c/policy"])[3:]).all()


def test_rewards_change_what_is_learnt():
    """A reward for the first action makes it likely."""
    losses = {"a2c": A2C(), "novelty": Novelty(size=5.0)}
    only = Stage(losses, steps=20 * UPDATE, rewards={"success": 0.0, "step": 0.0})
    state, metrics = jax.jit(make_train(experiment(stages=(only,))))(make_key(0))
    assert np.asarray(metrics["train/reward/novelty"])[-1] > 4.0
    assert_same(state.updates, jnp.array([20], jnp.int32))


def test_a_run_in_chunks_is_the_run_in_one(trained):
    program = Program(experiment(stages=stages()), choose_devices(1))
    state = program.start(make_key(0))
    numbers = program.numbers()
    for index in (0, 1):
        advance = program.stage(index, 2)
        for count in (2, 1):
            state, _ = advance(state, numbers, np.int32(count), program.data)
    for one, other in zip(*map(jax.tree.leaves, (state.params, trained[0].params)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


def other_storage():
    storage = stages()[0].storages["demonstrations"]
    first, second = stages()
    return first, replace(second, storages={"demonstrations": replace(storage, length=3)})


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda: stages(rewards={"stepp": 0.0}), "unknown reward component .*'stepp'.* 'step'"),
        (other_storage, "is another than that of this name in an earlier stage"),
        (lambda: (Stage({}, 1),), "at least one loss"),
        (
            lambda: Rightwards(losses={"a2c": A2C()}),
            "A2C .* learns from what the policy has just done",
        ),
        (
            lambda: Rightwards(losses={"imitation": Imitation()}, weights={"imitatoin": 1.0}),
            "unknown loss .*'imitatoin'; the nearest is 'imitation'",
        ),
    ],
)
def test_what_cannot_be(changed, message):
    with pytest.raises(JaxactError, match=message):
        experiment(stages=changed()).check()


def test_lanes_of_storages_divide_among_devices():
    with pytest.raises(JaxactError, match="its 4 lanes do not divide among 8 devices"):
        experiment(stages=stages(), minibatches=1).check(devices=8)
