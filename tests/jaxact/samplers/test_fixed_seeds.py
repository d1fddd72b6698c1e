"""Fixed levels are the sampler's own, and no others."""

import jax
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.samplers import FixedSeeds
from jaxact.train_state import make_key
from tests.corridor import RandomStart

SEEDS = (3, 7, 2**32 - 1)
LONG = RandomStart(length=1000)


def test_only_the_levels_of_the_seeds_are_played():
    sampler = FixedSeeds(LONG, SEEDS)
    keys = jax.random.split(make_key(0), 300)
    drawn = jax.jit(jax.vmap(lambda key: sampler.sample(key, sampler.init(key))))(keys)
    levels = [LONG.sample(make_key(np.uint32(seed)), ()) for seed in SEEDS]
    starts = [int(level.environment) for level in levels]
    assert len(set(starts)) == 3
    counts = [(np.asarray(drawn.environment) == start).sum() for start in starts]
    assert sum(counts) == 300
    assert min(counts) > 60


@pytest.mark.parametrize(
    ("seeds", "message"),
    [((), "at least one seed"), ((1, -1), "in 0 … 4294967295, got -1"), ((2**32,), "got 42949")],
)
def test_bad_seeds_are_answered_with_a_sentence(seeds, message):
    with pytest.raises(JaxactError, match=message):
        FixedSeeds(LONG, seeds)
