"""The crossings of ADVISOR's experiments have as many rivers as they should, and a way across."""

import jax
import numpy as np
import pytest
from scipy import ndimage

import envs_jax
from envs_jax.minigrid import tiles
from envs_jax.minigrid.state import PADDING


@pytest.mark.parametrize(
    ("name", "size", "rivers", "river"),
    [
        ("LavaCrossingS15N7", 15, 7, tiles.LAVA),
        ("LavaCrossingS25N10", 25, 10, tiles.LAVA),
        ("WallCrossingS25N10", 25, 10, tiles.WALL),
    ],
)
def test_rivers_can_be_crossed(name, size, rivers, river):
    pomdp = envs_jax.make(f"Advisor-{name}-v0")
    keys = jax.random.split(jax.random.key(0), 30)
    episodes = jax.jit(jax.vmap(pomdp.sampler.sample, (0, None)))(keys, ())
    assert set(np.asarray(episodes.horizon).tolist()) == {4 * size**2}
    inside = slice(PADDING + 1, PADDING + size - 1)
    planes = np.asarray(episodes.environment.tiles)[:, inside, inside] & tiles.TYPE_MASK
    for kinds in planes:
        wet = kinds == river
        # A river is a line of it with one opening.
        assert sum((wet.sum(axis) == size - 3).sum() for axis in (0, 1)) == rivers
        assert kinds[-1, -1] == tiles.GOAL
        land, _ = ndimage.label(~wet)
        assert land[0, 0] == land[-1, -1]
