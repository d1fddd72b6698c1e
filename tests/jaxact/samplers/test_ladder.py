"""The ladder climbs when, and only when, a whole block of the present rung went well."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.pomdp import FinishedEpisodes
from jaxact.samplers import LadderSampler, MixtureSampler
from jaxact.samplers.parts import PartOrigin
from jaxact.train_state import make_key
from tests.corridor import RandomStart

RUNGS = {name: RandomStart(horizon=5 + i) for i, name in enumerate(("easy", "medium", "hard"))}
LADDER = LadderSampler(RUNGS, promote_at=0.75, episodes=4, rehearsal=0.25)


def told(state, parts, success, ladder=LADDER):
    """Updates with episodes of these rungs that all ended, two lanes of them."""
    parts, success = (jnp.asarray(x).reshape(-1, 2) for x in (parts, success))
    finished = FinishedEpisodes(
        mask=jnp.ones(success.shape, bool),
        success=success.astype(bool),
        episode_return=jnp.zeros(success.shape, jnp.float32),
        length=jnp.ones(success.shape, jnp.int32),
        task=None,
        origin=PartOrigin(parts.astype(jnp.int32), None),
        mean_error=None,
    )
    return jax.jit(ladder.update)(state, finished)


def standing(state):
    return int(state.rung), int(state.episodes), int(state.successes)


def test_a_good_block_leads_up_and_a_bad_one_nowhere():
    state = LADDER.init(make_key(0))
    state = told(state, [0, 0], [1, 1])
    assert standing(state) == (0, 2, 2)  # the block is not full yet
    state = told(state, [0, 0], [0, 0])
    assert standing(state) == (0, 0, 0)  # 2 of 4
    state = told(state, [0, 0, 0, 0], [1, 1, 0, 1])
    assert standing(state) == (1, 0, 0)  # 3 of 4
    state = told(state, [0, 0, 0, 1], [1, 1, 1, 1])
    assert standing(state) == (1, 1, 1)  # rehearsals do not count
    state = told(state, [1, 1, 1, 2], [1, 1, 1, 1])
    assert standing(state) == (2, 0, 0)
    state = told(state, [2, 2, 2, 2], [1, 1, 1, 1])
    assert standing(state) == (2, 0, 0)  # the top


def test_episodes_are_of_the_present_rung_or_below():
    keys = jax.random.split(make_key(1), 2000)
    first = LADDER.init(make_key(0))

    @jax.jit
    def drawn(rung):
        state = dataclasses.replace(first, rung=rung)
        return jax.vmap(LADDER.sample, (0, None))(keys, state)

    for rung, expected in enumerate(([1, 0, 0], [0.25, 0.75, 0], [0.125, 0.125, 0.75])):
        episodes = drawn(jnp.int32(rung))
        part = np.asarray(episodes.origin.part)
        np.testing.assert_array_equal(episodes.horizon, 5 + part)
        shares = np.bincount(part, minlength=3) / len(part)
        np.testing.assert_allclose(shares, expected, atol=5 * np.sqrt(0.25 * 0.75 / len(part)))


def test_evaluation_plays_all_rungs():
    assert LADDER.held_out == MixtureSampler(RUNGS)
    assert set(LADDER.kinds(PartOrigin(jnp.int32(1), None))) == set(RUNGS)
    assert float(LADDER.metrics(LADDER.init(make_key(0)))["rung"]) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rungs": {}}, "a ladder needs at least one rung"),
        ({"promote_at": 1.5}, "promote_at must be in 0 … 1, got 1.5"),
        ({"rehearsal": -0.5}, "rehearsal must be in 0 … 1, got -0.5"),
        ({"episodes": 0}, "episodes must be at least 1, got 0"),
    ],
)
def test_bad_numbers_are_answered_with_a_sentence(change, message):
    with pytest.raises(JaxactError, match=message):
        dataclasses.replace(LADDER, **change)
