"""Turnover of episodes, and the values that truncation bootstraps from."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.distributions import Categorical
from jaxact.models.output import ActorCriticOutput
from jaxact.rollout import next_values, refill, rollout, start_lanes, turn_over
from tests.corridor import RandomStart, corridor

LANES, LENGTH = 8, 50


class Scripted:
    """Acts at random; its value is the cell it is told of, its memory counts steps."""

    @staticmethod
    def initial_memory(lanes):
        return jnp.zeros(lanes, jnp.int32)


def policy(observation, memory, previous_action, is_first):
    del previous_action
    memory = jnp.where(is_first, 0, memory) + 1
    cell = jnp.argmax(observation["vector"][..., :6], axis=-1)
    value = cell.astype(jnp.float32) + 100.0 * memory.astype(jnp.float32)
    return ActorCriticOutput(Categorical(jnp.zeros((*value.shape, 2))), value), memory


@pytest.fixture(scope="module")
def played():
    pomdp = corridor(horizon=5)
    keys = jax.random.split(jax.random.key(0), LANES)
    lanes = start_lanes(pomdp, (), Scripted, keys, queue_length=2)

    def run(lanes):
        after, trajectory = rollout(
            pomdp, policy, (), lanes, LENGTH, query_expert=True, teacher_forcing=0.5
        )
        return after, trajectory, next_values(policy, trajectory)

    return pomdp, lanes, jax.jit(run)(lanes)


def test_first_steps_follow_endings(played):
    _, _, (_, trajectory, _) = played
    is_first, finished = np.asarray(trajectory.is_first), np.asarray(trajectory.step.finished)
    assert finished.any()
    assert is_first[0].all()
    np.testing.assert_array_equal(is_first[1:], finished[:-1])


def test_episodes_are_those_of_the_lane_stream_in_order(played):
    """Each lane plays episodes 0, 1, 2, … of its own stream, none twice, whatever the queue."""
    pomdp, lanes, (_, trajectory, _) = played

    @jax.vmap
    def stream(key):
        keys = jax.vmap(lambda k: jax.random.fold_in(key, k))(jnp.arange(LENGTH))
        first = jax.vmap(lambda key: pomdp.observe(pomdp.begin(pomdp.sampler.sample(key, ()))))
        return first(keys)["vector"]

    episodes = np.asarray(stream(lanes.queue.key))
    is_first = np.asarray(trajectory.is_first)
    seen = np.asarray(trajectory.observation["vector"])
    for lane in range(LANES):
        starts = seen[is_first[:, lane], lane]
        np.testing.assert_array_equal(starts, episodes[lane, : len(starts)])
        assert len(starts) > 4, "the queue of two was to be refilled"


def test_queue_length_changes_nothing():
    pomdp = corridor(horizon=5)
    keys = jax.random.split(jax.random.key(1), LANES)

    def play(queue_length):
        lanes = start_lanes(pomdp, (), Scripted, keys, queue_length)
        return jax.jit(lambda lanes: rollout(pomdp, policy, (), lanes, LENGTH)[1])(lanes)

    one, other = play(1), play(7)
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_only_episodes_that_were_taken_are_replaced():
    @dataclasses.dataclass(frozen=True)
    class Stamped(RandomStart):
        def sample(self, key, sampler_state):
            return dataclasses.replace(super().sample(key, ()), origin=sampler_state)

    pomdp = dataclasses.replace(corridor(), sampler=Stamped())
    keys = jax.random.split(jax.random.key(0), 3)
    queue = start_lanes(pomdp, jnp.int32(0), Scripted, keys, 4).queue
    fill = jax.jit(lambda stamp, queue: refill(pomdp, stamp, queue))
    queue = fill(jnp.int32(1), queue)
    queue = fill(jnp.int32(2), dataclasses.replace(queue, served=jnp.array([0, 1, 4])))
    stamps = [[1, 1, 1, 1], [2, 1, 1, 1], [2, 2, 2, 2]]
    np.testing.assert_array_equal(queue.episodes.origin, stamps)
    np.testing.assert_array_equal(queue.drawn, [4, 5, 8])


def test_a_batch_of_runs_is_each_run_by_itself():
    pomdp = corridor(horizon=5)

    def play(key):
        lanes = start_lanes(pomdp, (), Scripted, jax.random.split(key, LANES), 2)
        return rollout(pomdp, policy, (), lanes, LENGTH)[1]

    keys = jax.random.split(jax.random.key(2), 3)
    together = jax.jit(jax.vmap(play))(keys)
    alone = jax.jit(play)(keys[1])
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[1], b), together, alone)


def test_runs_side_by_side_refill_their_queues_together():
    """When one is dry; what is sampled for the other then is kept."""
    pomdp = corridor()
    lanes = start_lanes(pomdp, (), Scripted, jax.random.split(jax.random.key(0), 2), 4)
    queue = dataclasses.replace(refill(pomdp, (), lanes.queue), served=jnp.array([3, 2]))
    finished = jnp.array([[True, False], [False, False]])

    @jax.jit
    @jax.vmap
    def turn(served, finished):
        one = dataclasses.replace(queue, served=served)
        return turn_over(pomdp, (), one, finished, lanes.state, lanes.observation)[0]

    none_dry = turn(jnp.array([[3, 2], [3, 2]]), finished)
    np.testing.assert_array_equal(none_dry.drawn, [[4, 4], [4, 4]])
    one_dry = turn(jnp.array([[4, 2], [3, 2]]), finished)
    np.testing.assert_array_equal(one_dry.drawn, [[8, 6], [7, 6]])
    np.testing.assert_array_equal(one_dry.served, [[5, 2], [3, 2]])
    expected = refill(pomdp, (), queue).episodes
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[1], b), one_dry.episodes, expected)


def test_levels_may_have_leaves_without_elements():
    @dataclasses.dataclass(frozen=True)
    class WithNothing(RandomStart):
        def sample(self, key, sampler_state):
            origin = jnp.zeros((0, 3), jnp.float32)
            return dataclasses.replace(super().sample(key, sampler_state), origin=origin)

    pomdp = dataclasses.replace(corridor(), sampler=WithNothing())
    lanes = start_lanes(pomdp, (), Scripted, jax.random.split(jax.random.key(0), LANES), 2)
    after, _ = jax.eval_shape(lambda lanes: rollout(pomdp, policy, (), lanes, LENGTH), lanes)
    assert after.queue.episodes.origin.shape == (LANES, 2, 0, 3)


def test_final_observations_are_bootstrapped_from(played):
    """The policy's value encodes what it saw and when, so each bootstrap can be told exactly."""
    _, _, (_, trajectory, values) = played
    step = jax.tree.map(np.asarray, trajectory.step)
    values, value = np.asarray(values), np.asarray(trajectory.value)
    cell = step.observation["vector"][..., :6].argmax(-1)
    truncated = step.truncated & ~step.terminated
    assert truncated[:-1].sum() > 5
    for t, b in np.argwhere(np.ones_like(truncated)):
        if step.terminated[t, b]:
            expected = 0.0
        elif truncated[t, b] or t == LENGTH - 1:
            expected = cell[t, b] + 100.0 * (np.asarray(trajectory.memory)[t, b] + 1)
        else:
            expected = value[t + 1, b]
        assert values[t, b] == expected


def test_teacher_forcing_takes_the_experts_actions(played):
    _, _, (_, trajectory, _) = played
    forced = np.asarray(trajectory.forced)
    assert 0.35 < forced.mean() < 0.65
    np.testing.assert_array_equal(
        np.asarray(trajectory.action)[forced], np.asarray(trajectory.expert.action)[forced]
    )


def test_returns_are_sums_of_rewards(played):
    _, _, (_, trajectory, _) = played
    mask = np.asarray(trajectory.finished.mask)
    reward = np.asarray(trajectory.step.reward)
    for lane in range(LANES):
        ends = np.flatnonzero(mask[:, lane])
        for begin, end in zip([-1, *ends[:-1]], ends, strict=True):
            total = reward[begin + 1 : end + 1, lane].sum()
            assert trajectory.finished.episode_return[end, lane] == pytest.approx(total, abs=1e-5)
            assert int(trajectory.finished.length[end, lane]) == end - begin
            terms = sum(float(x[end, lane]) for x in trajectory.episode_terms.values())
            assert terms == pytest.approx(total, abs=1e-5)


def test_task_can_be_swapped_in_the_same_world():
    pomdp = corridor()
    harsher = dataclasses.replace(pomdp, task=dataclasses.replace(pomdp.task, step_penalty=-1.0))
    key = jax.random.key(0)
    state, _ = harsher.reset(key)
    _, step = harsher.step(key, state, jnp.int32(0))
    assert float(step.reward_terms["step"]) == -1.0
