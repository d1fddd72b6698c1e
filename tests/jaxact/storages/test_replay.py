"""Replays against what was put in: every reward is the number of its step and lane."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.losses import DQN, PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.pomdp import FinishedEpisodes, Step
from jaxact.rollout import Trajectory
from jaxact.storages import PrioritizedReplay, Replay
from jaxact.train_state import make_key
from tests.corridor import corridor

POMDP = corridor()
MODEL = ActorCritic(POMDP.action_space, Concatenated({"vector": Vector((4,))}), GRU(2))
LOSSES = {"dqn": DQN()}


def replay(kind=Replay, **fields):
    return kind(**{"losses": LOSSES, "capacity": 12, "lanes": 4, "length": 3} | fields)


def start(storage, rings=4, seed=0):
    keys = jax.random.split(make_key(seed), storage.width(rings))
    return storage.init(POMDP, MODEL, keys, ())


def numbers(first, length, rings):
    """Step n of lane b is 100 b + n."""
    steps = first + jnp.arange(length, dtype=jnp.float32)
    return steps[:, None] + 100.0 * jnp.arange(rings, dtype=jnp.float32)


def memory_before(x):
    return jnp.stack([x, -x], axis=-1)


def trajectory(first, length, rings):
    x = numbers(first, length, rings)
    whole, none = x.astype(jnp.int32), jnp.zeros_like(x, bool)
    terms = {"success": x, "step": -x, "of a loss": x}
    observation = {"vector": jnp.broadcast_to(x[..., None], (*x.shape, 12))}
    after = numbers(first + 1, length, rings)
    return Trajectory(
        observation=observation,
        previous_action=whole - 1,
        is_first=whole % 5 == 0,
        action=whole,
        log_prob=-x,
        value=x,
        step=Step(observation, x, terms, whole % 5 == 4, whole % 10 == 9, none, {}),
        memory=memory_before(after),
        expert=None,
        forced=none,
        finished=FinishedEpisodes(none, none, x, whole, None, None, None),
        episode_terms={},
    )


def add(storage, state, first, length, rings=4):
    before = memory_before(numbers(first, 1, rings)[0])
    return storage.add(state, trajectory(first, length, rings), before)


def filled(storage, length, times=1, rings=4):
    """After so many rollouts of this length. To be compiled: op by op it takes its time."""

    def rollout(state, first):
        return add(storage, state, first, length, rings), None

    firsts = length * jnp.arange(times, dtype=jnp.float32)
    return jax.lax.scan(rollout, start(storage, rings), firsts)[0]


def drawn(storage, length, times, batches=60):
    """First steps of many sequences, [batches, lanes], and the last batch."""

    def draw(state, _):
        return storage.batch(state, (), None)

    @jax.jit
    def run():
        return jax.lax.scan(draw, filled(storage, length, times), None, batches)[1]

    every = run()
    return np.asarray(every.reward[:, 0]), jax.tree.map(lambda x: x[-1], every)


@pytest.mark.parametrize(
    ("kind", "stride", "length", "times", "expected"),
    [
        # Not full yet: nothing beyond what was written.
        (Replay, 1, 9, 1, range(7)),
        # Across the end of the array, not across the newest step.
        (PrioritizedReplay, 1, 5, 4, range(8, 18)),
        (Replay, 3, 5, 4, (9, 12, 15)),
        pytest.param(PrioritizedReplay, 1, 9, 1, range(7), marks=pytest.mark.slow),
        pytest.param(Replay, 1, 5, 4, range(8, 18), marks=pytest.mark.slow),
        pytest.param(PrioritizedReplay, 3, 5, 4, (9, 12, 15), marks=pytest.mark.slow),
        pytest.param(PrioritizedReplay, 3, 4, 1, (0,), marks=pytest.mark.slow),
        pytest.param(PrioritizedReplay, 4, 7, 5, (24, 28, 32), marks=pytest.mark.slow),
    ],
)
def test_exactly_the_sequences_wholly_held_are_drawn(kind, stride, length, times, expected):
    storage = replay(kind, stride=stride)
    found, batch = drawn(storage, length, times)
    for lane in range(4):
        assert sorted(set(found[:, lane] - 100 * lane)) == list(expected)
    x = found[-1] + np.arange(3)[:, None]
    whole = x.astype(int)
    np.testing.assert_array_equal(batch.reward, x)
    np.testing.assert_array_equal(batch.action, whole)
    np.testing.assert_array_equal(batch.previous_action, whole - 1)
    np.testing.assert_array_equal(batch.is_first, whole % 5 == 0)
    np.testing.assert_array_equal(batch.terminated, whole % 5 == 4)
    np.testing.assert_array_equal(batch.truncated, whole % 10 == 9)
    np.testing.assert_array_equal(batch.log_prob, -x)
    np.testing.assert_array_equal(batch.observation["vector"][..., 3], x)
    assert set(batch.reward_terms) == {"success", "step"}
    # The memory is that before the first step, also where rollouts meet.
    np.testing.assert_array_equal(batch.memory, memory_before(jnp.asarray(x[0])))
    with pytest.raises(JaxactError, match=r"asks for 'value', which a (Prioritized)?Replay does"):
        jnp.exp(batch.value)


def test_the_burn_in_comes_before_what_is_learnt():
    storage = replay(burn_in=2, stride=2)
    found, batch = drawn(storage, 5, 4)
    assert sorted(set(found[:, 0])) == [10, 12, 14, 16]
    early = np.asarray(batch.burn_in.observation["vector"][..., 0])
    np.testing.assert_array_equal(early, found[-1] - np.array([[2], [1]]))
    np.testing.assert_array_equal(batch.memory, memory_before(jnp.asarray(early[0])))


def test_learning_waits_for_enough_steps_and_for_a_whole_sequence():
    patient, eager = replay(start_after=32), replay()
    ready = jax.jit(lambda state: (patient.ready(state, None), eager.ready(state, None)))
    state = start(eager)
    for taken, expected in ((2, (False, False)), (7, (False, True)), (8, (True, True))):
        assert ready(dataclasses.replace(state, taken=state.taken + taken)) == expected


@pytest.mark.parametrize(
    ("kind", "rings", "lanes"),
    [
        (PrioritizedReplay, 2, 8),
        (Replay, 8, 2),
        pytest.param(PrioritizedReplay, 4, 4, marks=pytest.mark.slow),
        pytest.param(PrioritizedReplay, 8, 2, marks=pytest.mark.slow),
        pytest.param(Replay, 2, 8, marks=pytest.mark.slow),
    ],
)
def test_lanes_draw_from_rings_of_their_own_on_any_number_of_devices(kind, rings, lanes):
    storage = replay(kind, lanes=lanes)

    @jax.jit
    def run():
        state = filled(storage, 5, 2, rings)
        shards = jax.tree.map(lambda x: x.reshape(2, -1, *x.shape[1:]), state)
        in_two = jax.vmap(lambda s: storage.batch(s, (), "devices")[1], axis_name="devices")(shards)
        return storage.batch(state, (), None)[1], in_two

    batch, parts = run()
    ring = np.asarray(batch.reward[0]).astype(int) // 100
    # Ring r and lane l go together where r over the rings is l over the lanes, in whole groups.
    groups = min(rings, lanes)
    np.testing.assert_array_equal(ring * groups // rings, np.arange(lanes) * groups // lanes)
    np.testing.assert_array_equal(jnp.concatenate(list(parts.reward), axis=1), batch.reward)
    if batch.weight is not None:
        np.testing.assert_allclose(parts.weight.reshape(-1), batch.weight, rtol=1e-6)


def test_uniform_draws_are_uniform():
    storage = replay(lanes=400)
    found, _ = drawn(storage, 7, 3, batches=10)
    _, counts = np.unique(found, return_counts=True)
    assert counts.shape == (40,)  # ten sequences in each of four rings
    # 4000 draws of 40: 100 each, give or take 5 deviations.
    assert np.all(np.abs(counts - 100) < 50)


def test_draws_and_weights_are_by_priority():
    """P = p^α / Σ p^α in each lane's rings, weights (1 / P)^β over the greatest of the batch."""
    storage = replay(PrioritizedReplay, lanes=2, alpha=0.5, beta=0.7)
    many = dataclasses.replace(storage, lanes=4000)
    told = np.random.default_rng(0).uniform(0.1, 4.0, (80, 2))

    def tell(state, priority):
        state, batch = storage.batch(state, (), None)
        return storage.reprioritize(state, priority), batch.reward[0]

    @jax.jit
    def run(told):
        state, first = jax.lax.scan(tell, filled(storage, 8, rings=2), told)
        batch = many.batch(state, (), None)[1]
        return state.priority, first, batch.reward[0], batch.weight

    priority, *firsts, weights = run(jnp.asarray(told, jnp.float32))
    (ring, first), (later_ring, later) = (np.divmod(np.asarray(x).astype(int), 100) for x in firsts)
    error = np.zeros((2, 12))
    for row in range(80):
        error[ring[row], first[row]] = told[row]
    assert (error[:, :6] > 0).all()
    assert not error[:, 6:].any()
    np.testing.assert_allclose(priority[:, :6], np.sqrt(error[:, :6] + 1e-6), rtol=1e-5)

    p = np.sqrt(error) / np.sqrt(error).sum(1, keepdims=True)
    frequency = np.bincount(later_ring * 12 + later, minlength=24).reshape(2, 12) / 2000
    np.testing.assert_allclose(frequency, p, atol=5 * 0.5 / np.sqrt(2000))
    weight = p[later_ring, later] ** -0.7
    np.testing.assert_allclose(weights, weight / weight.max(), rtol=1e-3)


def test_new_sequences_have_the_highest_priority_of_their_ring():
    storage = replay(PrioritizedReplay, alpha=1.0)
    told = jnp.full((4, 12), 0.5, jnp.float32).at[2, 3].set(9.0)

    @jax.jit
    def run():
        state = filled(storage, 8)
        later = add(storage, dataclasses.replace(state, priority=told), 8, 2)
        return state.priority, later.priority

    before, after = run()
    np.testing.assert_array_equal(before[:, :8], 1.0)
    np.testing.assert_array_equal(after[:, 8], [0.5, 0.5, 9.0, 0.5])
    np.testing.assert_array_equal(after[:, 10], 0.5)


def test_what_is_not_held_has_no_priority():
    """Before anything is ready the losses are told of sequences that there are not."""
    storage = replay(PrioritizedReplay)

    @jax.jit
    def run():
        state, _ = storage.batch(filled(storage, 2), (), None)
        told = storage.reprioritize(state, jnp.full(4, 7.0, jnp.float32))
        return state.priority, told.priority

    before, after = run()
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"capacity": 3}, "cannot do with a capacity of 3; the least is 4"),
        ({"capacity": 6, "burn_in": 4}, "sequences of 7 steps.* the least is 8"),
        ({"stride": 5}, "a divisor of its capacity; they are 0, 5 and 12"),
        ({"losses": {"ppo": PPO()}}, "cannot be among the losses of a Replay"),
    ],
)
def test_sizes_that_cannot_work(fields, message):
    with pytest.raises(JaxactError, match=message):
        replay(**fields)


def test_lanes_that_do_not_divide():
    with pytest.raises(JaxactError, match="batches of 4 lanes cannot be drawn evenly from 6"):
        start(replay(), rings=6)
    with pytest.raises(JaxactError, match="cannot hold a rollout of 13"):
        filled(replay(), 13)
