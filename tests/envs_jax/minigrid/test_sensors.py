from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from minigrid.core.grid import Grid
from minigrid.core.world_object import Wall

import envs_jax
from envs_jax.minigrid import tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.sensors import ImageSensor, PackedImageSensor
from jaxact.errors import JaxactError


def test_occlusion_is_the_packages_on_random_walls():
    """The agent looks up from the middle of the lowest row of a 7×7 grid: its view is the grid."""
    rng = np.random.default_rng(0)
    walls = rng.random((300, 7, 7)) < rng.uniform(0.05, 0.6, (300, 1, 1))
    sensor = PackedImageSensor(7, 7)

    def observe(walls: jax.Array) -> jax.Array:
        plane = jnp.where(walls, jnp.uint8(tiles.WALL_TILE), jnp.uint8(tiles.EMPTY_TILE))
        state = placement.grid_state(plane, jnp.array([3, 6], jnp.int32), jnp.int32(3))
        return sensor.observe(state, None)

    seen = np.asarray(jax.jit(jax.vmap(observe))(walls)) != tiles.UNSEEN
    for mine, cells in zip(seen, walls, strict=True):
        grid = Grid(7, 7)
        for x, y in np.argwhere(cells):
            grid.set(x, y, Wall())
        np.testing.assert_array_equal(mine, grid.process_vis((3, 6)))


def test_the_packed_view_decodes_to_the_image():
    pomdp = envs_jax.make("MiniGrid-FourRooms-v0")
    state, observation = jax.jit(pomdp.reset)(jax.random.key(0))
    packed = PackedImageSensor(19, 19).observe(state.environment, state.task)
    assert packed.shape == (7, 7)
    np.testing.assert_array_equal(tiles.decode(packed), observation["image"])


def test_observations_lie_in_their_spaces():
    for name in ("MiniGrid-DoorKey-5x5-v0", "BabyAI-GoToLocal-v0"):
        pomdp = envs_jax.make(name)
        _, observation = jax.jit(pomdp.reset)(jax.random.key(0))
        assert pomdp.observation_space.contains(observation)
        structure = pomdp.observation_space.structure
        assert jax.tree.map(lambda x: (x.shape, x.dtype), observation) == jax.tree.map(
            lambda x: (x.shape, x.dtype), structure
        )


@pytest.mark.parametrize("view_size", [1, 4, 33])
def test_view_sizes_that_do_not_fit_are_refused(view_size):
    with pytest.raises(JaxactError, match="view_size must be odd, from 3 to 31"):
        ImageSensor(8, 8, view_size)
    with pytest.raises(JaxactError, match="view_size"):
        envs_jax.make("MiniGrid-Empty-8x8-v0", view_size=view_size)


def test_worlds_run_under_strict_promotion_and_rank_rules():
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        pomdp = envs_jax.make("BabyAI-GoToRedBall-v0")
        state, _ = jax.jit(pomdp.reset)(jax.random.key(0))
        jax.jit(pomdp.step)(jax.random.key(0), state, jnp.int32(2))
