"""Failed levels wait, are given again as they should, and are let go of, one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.pomdp import FinishedEpisodes
from jaxact.samplers import RepeatFailed
from jaxact.samplers.levels import LevelOrigin
from jaxact.samplers.repeat_failed import WaitingLevels
from jaxact.train_state import make_key
from tests.corridor import RandomStart

LONG = RandomStart(length=1000)
REPEAT = RepeatFailed(LONG, min_steps=10.0, size=4)


def state_of(waiting, ended):
    """Levels that wait, as steps by seed."""
    missing = [0] * (REPEAT.size - len(waiting))
    seeds, steps = [*waiting, *missing], [*waiting.values(), *missing]
    return WaitingLevels(
        jnp.asarray(seeds, jnp.uint32),
        jnp.asarray(steps, jnp.int32),
        jnp.int32(len(waiting)),
        jnp.int32(ended),
        (),
    )


def finished(*episodes):
    """Episodes (seed, is_new, success, length) on two lanes; None where none ended."""
    mask = [episode is not None for episode in episodes]
    seed, is_new, success, length = zip(*(x or (0, True, False, 1) for x in episodes), strict=True)

    def lanes(x, dtype):
        return jnp.asarray(x, dtype).reshape(-1, 2)

    return FinishedEpisodes(
        mask=lanes(mask, bool),
        success=lanes(success, bool),
        episode_return=lanes(np.zeros(len(mask)), jnp.float32),
        length=lanes(length, jnp.int32),
        task=None,
        origin=LevelOrigin(lanes(seed, jnp.uint32), lanes(is_new, bool), None),
        mean_error=None,
    )


update = jax.jit(REPEAT.update)
draw = jax.jit(jax.vmap(REPEAT.sample, (0, None)))


def waiting(state):
    """Steps by seed, in the order of their places."""
    count = int(state.count)
    assert not np.asarray(state.seed[count:]).any()
    return dict(zip(state.seed[:count].tolist(), state.steps[:count].tolist(), strict=True))


def test_failed_levels_wait_until_they_succeed_or_enough_was_spent():
    state = update(
        REPEAT.init(make_key(0)),
        finished((11, True, False, 3), (12, True, True, 3), (13, True, False, 10), None),
    )
    # 12 succeeded, and on 13 enough was spent at once.
    assert waiting(state) == {11: 3}
    state = update(state, finished((14, True, False, 9), (11, False, False, 2)))
    assert waiting(state) == {11: 5, 14: 9}
    # Two lanes at once; one more step is enough; 12 was let go of before.
    state = update(
        state,
        finished(
            (11, False, False, 2),
            (14, False, False, 1),
            (12, False, False, 1),
            (11, False, False, 2),
        ),
    )
    assert waiting(state) == {11: 9}
    # One of two lanes succeeded.
    state = update(state, finished((11, False, True, 1), (11, False, False, 0)))
    assert waiting(state) == {}
    assert int(state.ended) == 2
    assert int(update(state, finished(None, None)).ended) == 2


def test_levels_without_a_place_are_given_up():
    new = [(seed, True, False, seed) for seed in (1, 2, 3, 4)]
    state = update(state_of({7: 1, 0: 2}, 2), finished(*new))
    assert waiting(state) == {7: 1, 0: 2, 1: 1, 2: 2}
    state = update(state, finished((7, False, True, 1), (5, True, False, 5)))
    assert waiting(state) == {0: 2, 1: 1, 2: 2, 5: 5}


def test_each_level_is_given_again_about_once_in_a_rollout():
    state = state_of({5: 1, 0: 1, 7: 1}, ended=6)
    keys = jax.random.split(make_key(0), 4000)
    drawn = draw(keys, state)
    is_new, seed = np.asarray(drawn.origin.is_new), np.asarray(drawn.origin.seed)
    assert abs(is_new.mean() - 0.5) < 5 * np.sqrt(0.25 / 4000)
    assert len(set(seed[is_new].tolist())) == is_new.sum()
    shares = [(seed[~is_new] == s).mean() for s in (5, 0, 7)]
    assert sum(shares) == pytest.approx(1)
    np.testing.assert_allclose(shares, 1 / 3, atol=5 * np.sqrt(0.25 / 2000))
    for index in (0, 1, np.flatnonzero(~is_new)[0]):
        level = LONG.sample(make_key(seed[index]), ())
        assert int(level.environment) == int(drawn.environment[index])
    metrics = REPEAT.metrics(state)
    assert (float(metrics["waiting"]), float(metrics["share"])) == (3, 0.5)


def test_nothing_is_repeated_that_does_not_wait_and_nothing_else_when_many_do():
    keys = jax.random.split(make_key(0), 50)
    assert np.asarray(draw(keys, REPEAT.init(make_key(0))).origin.is_new).all()
    assert not np.asarray(draw(keys, state_of({5: 1, 6: 1, 7: 1}, ended=2)).origin.is_new).any()


def test_where_all_fail_levels_are_given_again_until_enough_was_spent():
    """Of four attempts of one step each three are repeats, and a few more.

    Each waiting level is given again about once a rollout, by chance: a Poisson number of times. It
    waits for as many rollouts as it takes until three have come together.
    """
    sampler = dataclasses.replace(REPEAT, min_steps=4.0, size=300)

    def rollout(state, key):
        origin = jax.vmap(sampler.sample, (0, None))(jax.random.split(key, 200), state).origin
        ones = jnp.ones((1, 200), jnp.int32)
        failed = FinishedEpisodes(
            mask=ones > 0,
            success=ones == 0,
            episode_return=0.0 * ones.astype(jnp.float32),
            length=ones,
            task=None,
            origin=jax.tree.map(lambda x: x[None], origin),
            mean_error=None,
        )
        return sampler.update(state, failed), jnp.mean(origin.is_new, dtype=jnp.float32)

    def run(key):
        state = sampler.init(key)
        return jax.lax.scan(rollout, state, jax.random.split(key, 60))[1]

    keys = jax.random.split(make_key(0), 3)
    # As in a sweep: each run has waiting levels of its own.
    shares = np.asarray(jax.jit(jax.vmap(run))(keys))[:, 20:].mean(axis=1)
    rollouts = sum(np.exp(-k) * (1 + k + k**2 / 2) for k in range(50))
    assert 3 < rollouts < 4
    np.testing.assert_allclose(shares, 1 / (1 + rollouts), atol=0.01)
    assert len(set(shares.tolist())) > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": 0}, "size must be at least 1, got 0"),
        ({"min_steps": -1.0}, "min_steps must not be negative, got -1.0"),
    ],
)
def test_bad_numbers_are_answered_with_a_sentence(change, message):
    with pytest.raises(JaxactError, match=message):
        dataclasses.replace(REPEAT, **change)
