"""Prioritized level replay against the paper's formulas, and its buffer's places one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.pomdp import FinishedEpisodes
from jaxact.samplers import PrioritizedLevelReplay
from jaxact.samplers.level_replay import LevelBuffer
from jaxact.samplers.levels import LevelOrigin
from jaxact.train_state import make_key
from tests.corridor import RandomStart

LONG = RandomStart(length=1000)
REPLAY = PrioritizedLevelReplay(LONG, size=4, replay=0.75, temperature=0.5, staleness=0.25)
NONE = -np.inf


def buffer(seeds, scores, played_at, episodes):
    return LevelBuffer(
        jnp.asarray(seeds, jnp.uint32),
        jnp.asarray(scores, jnp.float32),
        jnp.asarray(played_at, jnp.int32),
        jnp.int32(episodes),
        (),
    )


def told(state, seeds, is_new, scores, mask=None):
    """Updates with episodes of these levels, two lanes of them."""

    def lanes(x, dtype):
        return jnp.asarray(x, dtype).reshape(-1, 2)

    finished = FinishedEpisodes(
        mask=lanes(np.ones(len(seeds)) if mask is None else mask, bool),
        success=lanes(np.zeros(len(seeds)), bool),
        episode_return=lanes(scores, jnp.float32),
        length=lanes(np.ones(len(seeds)), jnp.int32),
        task=None,
        origin=LevelOrigin(lanes(seeds, jnp.uint32), lanes(is_new, bool), None),
        mean_error=lanes(scores, jnp.float32),
    )
    return jax.jit(REPLAY.update)(state, finished)


def held(state):
    """Score and last episode by seed."""
    return {
        int(seed): (float(score), int(played))
        for seed, score, played in zip(state.seed, state.score, state.played_at, strict=True)
        if np.isfinite(score)
    }


def test_probabilities_are_the_papers():
    state = buffer([5, 6, 7, 0], [0.1, 0.9, 0.5, NONE], [10, 16, 4, 0], 20)
    by_score = np.array([1 / 9, 1, 1 / 4, 0])  # rank to the power of −1 / 0.5
    by_age = np.array([10, 4, 16, 0])
    expected = 0.75 * by_score / by_score.sum() + 0.25 * by_age / by_age.sum()
    np.testing.assert_allclose(REPLAY.probabilities(state), expected, rtol=1e-6)
    fresh = dataclasses.replace(state, played_at=jnp.full(4, 20, jnp.int32))
    np.testing.assert_allclose(REPLAY.probabilities(fresh), by_score / by_score.sum(), rtol=1e-6)


def test_levels_are_drawn_with_these_probabilities():
    state = buffer([5, 6, 7, 0], [0.1, 0.9, 0.5, NONE], [10, 16, 4, 0], 20)
    keys = jax.random.split(make_key(0), 4000)
    drawn = jax.jit(jax.vmap(REPLAY.sample, (0, None)))(keys, state)
    is_new, seed = np.asarray(drawn.origin.is_new), np.asarray(drawn.origin.seed)
    assert abs(is_new.mean() - 0.25) < 5 * np.sqrt(0.25 * 0.75 / 4000)
    assert len(set(seed[is_new].tolist())) == is_new.sum()
    replayed = seed[~is_new]
    shares = [(replayed == s).mean() for s in (5, 6, 7)]
    expected = np.asarray(REPLAY.probabilities(state))[:3]
    np.testing.assert_allclose(shares, expected, atol=5 * np.sqrt(0.25 / len(replayed)))
    assert sum(shares) == pytest.approx(1)
    for index in (0, 1, 2, np.flatnonzero(~is_new)[0]):
        level = LONG.sample(make_key(seed[index]), ())
        assert int(level.environment) == int(drawn.environment[index])


def test_without_levels_all_are_new():
    state = REPLAY.init(make_key(0))
    drawn = jax.jit(jax.vmap(REPLAY.sample, (0, None)))(jax.random.split(make_key(0), 50), state)
    assert np.asarray(drawn.origin.is_new).all()


def test_new_levels_take_free_places_then_those_of_less():
    state = told(
        REPLAY.init(make_key(0)), [11, 12, 13, 0], [1, 1, 1, 1], [3, 1, 2, 9], [1, 1, 1, 0]
    )
    assert held(state) == {11: (3, 3), 12: (1, 3), 13: (2, 3)}
    state = told(state, [14, 15], [1, 1], [0.5, 1.5])
    # The better of the two takes the last place; the other scores less than all.
    assert held(state) == {11: (3, 3), 12: (1, 3), 13: (2, 3), 15: (1.5, 5)}
    state = told(state, [16, 17], [1, 1], [0.9, 4])
    # 15 is the least probable: it ranks above 12, but is less stale. 16 scores less than 12.
    assert held(state) == {11: (3, 3), 12: (1, 3), 13: (2, 3), 17: (4, 7)}


def test_levels_played_again_are_scored_anew():
    state = buffer([0, 6, 7, 0], [0.1, 0.9, 0.5, NONE], [10, 16, 4, 0], 20)
    state = told(state, [6, 6, 0, 8], [0, 0, 0, 0], [2, 4, 5, 9])
    # The mean of both; the level with seed 0 is not the empty place; 8 was thrown out before.
    assert held(state) == {0: (5, 24), 6: (3, 24), 7: (0.5, 4)}
    assert int(state.episodes) == 24
    metrics = REPLAY.metrics(state)
    assert float(metrics["levels"]) == 3
    assert float(metrics["score"]) == pytest.approx(8.5 / 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": 0}, "size must be at least 1, got 0"),
        ({"temperature": 0.0}, "temperature must be positive, got 0.0"),
        ({"replay": 2.0}, "replay must be in 0 … 1, got 2.0"),
        ({"staleness": -1.0}, "staleness must be in 0 … 1, got -1.0"),
    ],
)
def test_bad_numbers_are_answered_with_a_sentence(change, message):
    with pytest.raises(JaxactError, match=message):
        dataclasses.replace(REPLAY, **change)
