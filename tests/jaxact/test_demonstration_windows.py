"""Lanes that stream through recorded episodes: every episode once an epoch, whole and in order."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.demonstration_windows import DemonstrationData, next_windows, start_cursor

advance = jax.jit(next_windows, static_argnums=2)


def data(lengths):
    """Steps that know their number; actions are a tree, and never zero."""
    first = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    steps = np.arange(first[-1], dtype=np.int32)
    ends = np.isin(steps, first[1:] - 1)
    return jax.tree.map(
        jnp.asarray,
        DemonstrationData(
            first_step=first,
            observation={"step": steps, "pair": np.stack([steps, -steps], axis=1)},
            action={"arm": (steps + 1).astype(np.float32), "hand": steps + 1},
            valid=steps % 3 != 0,
            reward=steps.astype(np.float32),
            terminated=ends & (steps % 2 == 0),
            truncated=ends & (steps % 2 == 1),
        ),
    )


def stream(recorded, lanes, length, count, seed=0):
    """The steps that each lane is served [count · T, B], and everything else of them."""
    cursor = start_cursor(recorded.episodes, lanes, jax.random.key(seed))
    parts = []
    for _ in range(count):
        windows, cursor = advance(recorded, cursor, length)
        parts.append(jax.tree.map(np.asarray, windows))
    return jax.tree.map(lambda *xs: np.concatenate(xs), *parts)


def order(windows):
    """The episodes that each lane was served, in their order."""
    return [
        windows.episode[windows.is_first[:, lane], lane]
        for lane in range(windows.is_first.shape[1])
    ]


def in_time(windows):
    """The episodes in the order in which they began; at the same step, that of the lanes."""
    return windows.episode[windows.is_first]


RANDOM = np.random.default_rng(0)
LENGTHS = {
    "random": RANDOM.integers(1, 12, 37),
    "ones": np.ones(37, int),
    "long": RANDOM.integers(20, 40, 37),
}


@pytest.mark.parametrize("kind", LENGTHS)
def test_windows_joined_in_time_are_the_episodes(kind):
    lengths = LENGTHS[kind]
    recorded = data(lengths)
    windows = stream(recorded, lanes=5, length=7, count=40)
    first = np.asarray(recorded.first_step)
    for lane, episodes in enumerate(order(windows)):
        expected = np.concatenate([np.arange(first[e], first[e + 1]) for e in episodes])
        served = windows.observation["step"][:, lane]
        np.testing.assert_array_equal(served, expected[: len(served)])
        assert len(expected) - lengths[episodes[-1]] < len(served) <= len(expected)


def test_everything_of_a_step_belongs_together():
    recorded = data(LENGTHS["random"])
    windows = stream(recorded, lanes=5, length=7, count=20)
    step = windows.observation["step"]
    np.testing.assert_array_equal(windows.observation["pair"], np.stack([step, -step], axis=-1))
    np.testing.assert_array_equal(windows.expert.action["hand"], step + 1)
    np.testing.assert_array_equal(windows.expert.action["arm"], step + 1)
    np.testing.assert_array_equal(windows.expert.valid, step % 3 != 0)
    np.testing.assert_array_equal(windows.reward, step)
    for name in ("terminated", "truncated"):
        np.testing.assert_array_equal(getattr(windows, name), getattr(recorded, name)[step])
    first = np.asarray(recorded.first_step)
    np.testing.assert_array_equal(windows.is_first, np.isin(step, first[:-1]))
    np.testing.assert_array_equal(windows.episode, np.searchsorted(first, step, side="right") - 1)


def test_previous_actions_are_zeros_at_first_and_cross_windows():
    windows = stream(data(LENGTHS["random"]), lanes=5, length=7, count=20)
    expected = np.where(windows.is_first, 0, windows.observation["step"])
    np.testing.assert_array_equal(windows.previous_action["hand"], expected)
    np.testing.assert_array_equal(windows.previous_action["arm"], expected)
    assert (windows.previous_action["hand"][7::7] > 0).any()


@pytest.mark.parametrize(
    ("episodes", "lanes", "lengths"),
    [
        (12, 4, lambda n: RANDOM.integers(1, 4, n)),
        # One in ten is twenty times as long as the others.
        (100, 8, lambda n: np.where(np.arange(n) % 10 == 0, 40, 2)),
        (101, 8, lambda n: np.minimum(RANDOM.geometric(0.2, n), 64)),
        (3, 16, lambda n: RANDOM.integers(1, 4, n)),
    ],
)
def test_no_episode_begins_again_before_all_have_begun(episodes, lanes, lengths):
    recorded = data(lengths(episodes))
    steps = 4 * len(recorded.reward) + 16 * lanes
    served = in_time(stream(recorded, lanes, length=16, count=-(-steps // (16 * lanes))))
    epochs = len(served) // episodes
    assert epochs >= 3
    epochs = served[: epochs * episodes].reshape(epochs, episodes)
    np.testing.assert_array_equal(
        np.sort(epochs, axis=1), np.tile(np.arange(episodes), (len(epochs), 1))
    )
    if episodes >= 12:
        assert not (epochs[0] == epochs[1]).all()
        assert not (epochs[1] == epochs[2]).all()


def test_seeds_give_different_orders():
    recorded = data(LENGTHS["random"])
    one, again, other = (in_time(stream(recorded, 4, 8, 10, seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one[:20], other[:20])


def test_lanes_may_be_shared_out():
    """Each device's share of the lanes is served what it is served among all of them."""
    recorded = data(LENGTHS["random"])
    cursor = start_cursor(recorded.episodes, 8, jax.random.key(0))
    shares = jax.tree.map(lambda x: x.reshape(2, 4), cursor)

    @jax.jit
    @partial(jax.vmap, axis_name="devices")
    def two_windows(share):
        first, share = next_windows(recorded, share, 8, "devices")
        second, _ = next_windows(recorded, share, 8, "devices")
        return jax.tree.map(lambda *x: jnp.concatenate(x), first, second)

    def side_by_side(x):
        return np.concatenate(x, axis=1)

    together = stream(recorded, 8, 8, 2)
    apart = jax.tree.map(side_by_side, two_windows(shares))
    jax.tree.map(np.testing.assert_array_equal, together, apart)


def test_the_length_of_windows_changes_nothing():
    recorded = data(LENGTHS["long"])
    one, other = stream(recorded, 4, 6, 20), stream(recorded, 4, 60, 2)
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_inside_a_scan_with_the_data_as_an_argument():
    recorded = data(LENGTHS["random"])
    cursor = start_cursor(recorded.episodes, 4, jax.random.key(0))

    @jax.jit
    def run(recorded, cursor):
        def one(cursor, _):
            windows, cursor = next_windows(recorded, cursor, 8)
            return cursor, windows.observation["step"]

        return jax.lax.scan(one, cursor, None, 3)[1]

    expected = stream(recorded, 4, 8, 3).observation["step"]
    np.testing.assert_array_equal(np.concatenate(run(recorded, cursor)), expected)
