"""Every image that a world can be made with, beside MiniGrid's wrappers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
import pytest
from minigrid.wrappers import (
    FullyObsWrapper,
    RGBImgObsWrapper,
    RGBImgPartialObsWrapper,
    ViewSizeWrapper,
)
from minigrid_reference import python_env, scramble, stays_inside

import envs_jax
from envs_jax.minigrid import interop, tiles
from jaxact.errors import JaxactError

WRAPPERS = {"full": FullyObsWrapper, "rgb": RGBImgPartialObsWrapper, "rgb_full": RGBImgObsWrapper}
WORLDS = [
    "MiniGrid-DoorKey-6x6-v0",
    "MiniGrid-Dynamic-Obstacles-5x5-v0",
    "BabyAI-KeyInBox-v0",
]
MORE_WORLDS = [
    "MiniGrid-Playground-v0",
    "MiniGrid-LavaGapS7-v0",
    "MiniGrid-RedBlueDoors-6x6-v0",
    "MiniGrid-MemoryS7-v0",
    "BabyAI-PutNextS5N2Carrying-v0",
    "BabyAI-BossLevel-v0",
]
OBSERVATIONS = ("image", "packed", "full", "rgb", "rgb_full")


def moments(env: Any, count: int) -> Iterator[None]:
    """Plays `env` at random, changing it by hand now and then, and stops `count` times."""
    rng = np.random.default_rng(0)
    for moment in range(count):
        if moment % 8 == 0:
            env.reset(seed=moment)
        for action in rng.choice([0, 1, 2, 2, 2, 3, 4, 5], size=3):
            if stays_inside(env, action):
                env.step(action)
        if moment % 4 == 3:
            scramble(env, rng)
        yield


def check_images(
    name: str, wrap: Callable[[Any], Any], count: int, agent_view_size: int = 7, **options: Any
) -> None:
    """Compares the image of `make(name, **options)` with that of a wrapper at many moments."""
    env = python_env(name, agent_view_size=agent_view_size)
    wrapper = wrap(env)
    states, images = [], []
    for _ in moments(env, count):
        states.append(interop.from_minigrid(env)[1].environment)
        images.append(wrapper.observation(env.gen_obs())["image"])
    sensor = envs_jax.make(name, **options).sensors["image"]
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    ours = jax.jit(jax.vmap(lambda state: sensor.observe(state, None)))(batch)
    np.testing.assert_array_equal(ours, np.stack(images))
    assert ours.shape[1:] == sensor.space.shape == wrapper.observation_space["image"].shape
    assert ours.dtype == sensor.space.dtype == wrapper.observation_space["image"].dtype


@pytest.mark.parametrize("observation", WRAPPERS)
@pytest.mark.parametrize("name", WORLDS)
def test_images_are_those_of_the_wrappers(name: str, observation: str) -> None:
    check_images(name, WRAPPERS[observation], 24, observation=observation)


@pytest.mark.slow
@pytest.mark.parametrize("observation", WRAPPERS)
@pytest.mark.parametrize("name", MORE_WORLDS)
def test_images_of_more_worlds_are_those_of_the_wrappers(name: str, observation: str) -> None:
    check_images(name, WRAPPERS[observation], 200, observation=observation)


@pytest.mark.parametrize("observation", ["rgb", "rgb_full"])
def test_pixels_of_other_views_and_tiles_are_those_of_the_wrappers(observation: str) -> None:
    def wrap(env: Any) -> Any:
        return WRAPPERS[observation](env, tile_size=5)

    options = {"observation": observation, "view_size": 9, "tile_size": 5}
    check_images("MiniGrid-FourRooms-v0", wrap, 16, agent_view_size=9, **options)


@pytest.mark.parametrize("view_size", [3, 5, 9, 17, 31])
@pytest.mark.parametrize("name", ["MiniGrid-FourRooms-v0", "MiniGrid-GoToDoor-8x8-v0"])
def test_views_of_every_size_are_those_of_the_wrapper(name: str, view_size: int) -> None:
    def wrap(env: Any) -> Any:
        return ViewSizeWrapper(env, view_size)

    check_images(name, wrap, 24, view_size=view_size)


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_every_observation_lies_in_its_space_and_can_be_filmed(observation: str) -> None:
    pomdp = envs_jax.make("MiniGrid-Empty-5x5-v0", observation=observation)
    state, reading = jax.jit(pomdp.reset)(jax.random.key(0))
    assert pomdp.observation_space.contains(reading)
    picture = jax.eval_shape(pomdp.pictures, state)["image"]
    assert picture.shape == (224, 160 + 16 + 224, 3)


def test_the_packed_observation_decodes_to_the_image() -> None:
    plain, packed = (
        jax.jit(envs_jax.make("BabyAI-GoToLocal-v0", observation=kind).reset)(jax.random.key(3))[1]
        for kind in ("image", "packed")
    )
    np.testing.assert_array_equal(tiles.decode(packed["image"]), plain["image"])
    np.testing.assert_array_equal(packed["mission"], plain["mission"])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"observation": "rbg"}, "unknown observation 'rbg'; the nearest is 'rgb'"),
        ({"observation": None}, "unknown observation 'None'; the nearest is"),
        ({"viewsize": 5}, "unknown option of .* 'viewsize'; the nearest is 'view_size'"),
        ({"observation": "rgb", "tile_size": 0}, "tile_size must be an int of at least 1; got 0"),
    ],
)
def test_options_that_do_not_exist_are_answered_with_the_nearest(
    options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(JaxactError, match=sentence):
        envs_jax.make("MiniGrid-Empty-8x8-v0", **options)
