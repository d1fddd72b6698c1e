"""Frames against MiniGrid's own, pixel for pixel."""

from __future__ import annotations

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import minigrid  # noqa: F401  (registers its environments)
import numpy as np
import pytest
from minigrid.core.constants import COLOR_NAMES, COLOR_TO_IDX
from minigrid.core.grid import Grid
from minigrid.core.world_object import Ball, Box, Door, Floor, Goal, Key, Lava, Wall

from envs_jax.minigrid import interop, pictures, rendering, tiles

KINDS = {
    tiles.WALL: Wall,
    tiles.FLOOR: Floor,
    tiles.KEY: Key,
    tiles.BALL: Ball,
    tiles.BOX: Box,
    tiles.GOAL: Goal,
    tiles.OPEN_DOOR: lambda color: Door(color, is_open=True),
    tiles.CLOSED_DOOR: lambda color: Door(color),
    tiles.LOCKED_DOOR: lambda color: Door(color, is_locked=True),
    tiles.OPEN_LOCKED_DOOR: lambda color: Door(color, is_open=True, is_locked=True),
    tiles.LAVA: lambda color: Lava(),
    tiles.EMPTY: lambda color: None,
    tiles.UNSEEN: lambda color: None,
}


def assert_tiles_equal(tile_size: int, color: str, directions: list[int | None]) -> None:
    atlas = pictures.atlas(tile_size)
    for kind, make in KINDS.items():
        row = kind * tiles.NUM_COLORS + COLOR_TO_IDX[color]
        for direction in directions:
            agent = 0 if direction is None else direction + 1
            for highlight in (False, True):
                drawn = Grid.render_tile(make(color), direction, highlight, tile_size)
                picture = atlas[(row * pictures.NUM_AGENTS + agent) * 2 + highlight]
                expected = drawn.astype(np.uint8)
                np.testing.assert_array_equal(picture, expected, f"{kind} {color} {direction}")


@pytest.mark.parametrize("color", COLOR_NAMES)
def test_small_tiles_of_all_kinds_and_colors(color: str) -> None:
    # The agent is drawn over all alike: one colour will do.
    assert_tiles_equal(8, color, [None, 0, 1, 2, 3] if color == "red" else [None])


def test_full_size_tiles() -> None:
    assert_tiles_equal(32, "purple", [None])


@pytest.mark.slow
@pytest.mark.parametrize("color", COLOR_NAMES)
@pytest.mark.parametrize("tile_size", [5, 16, 32])
def test_tiles_of_all_sizes(tile_size: int, color: str) -> None:
    assert_tiles_equal(tile_size, color, [None, 0, 1, 2, 3])


def wander(name: str, steps: int) -> list[Any]:
    """Returns the environment again after every step of a random walk (one object throughout)."""
    env = gymnasium.make(name).unwrapped
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for seed in range(1, steps + 1):
        yield env
        _, _, terminated, truncated, _ = env.step(rng.choice([0, 1, 2, 2, 2, 3, 4, 5]))
        if terminated or truncated:
            env.reset(seed=seed)
    env.close()


def check_frames(name: str, steps: int, tile_size: int) -> None:
    draw = view = None
    for env in wander(name, steps):
        pomdp, state = interop.from_minigrid(env)
        if draw is None:
            through, size = env.see_through_walls, (env.width, env.height)
            draw = jax.jit(
                lambda world, size=size, through=through: [
                    rendering.render(
                        world, *size, tile_size, highlight=on, see_through_walls=through
                    )
                    for on in (True, False)
                ]
            )
            image = pomdp.sensors["image"]
            view = jax.jit(
                lambda world, image=image: rendering.render_egocentric(
                    image.observe(world, None), tile_size
                )
            )
        with jax.numpy_dtype_promotion("strict"):
            lit, plain = draw(state.environment)
            own = view(state.environment)
        assert lit.dtype == plain.dtype == own.dtype == jnp.uint8
        np.testing.assert_array_equal(lit, env.get_frame(True, tile_size))
        np.testing.assert_array_equal(plain, env.get_frame(False, tile_size))
        np.testing.assert_array_equal(own, env.get_frame(True, tile_size, agent_pov=True))


@pytest.mark.parametrize(
    "name",
    ["MiniGrid-DoorKey-6x6-v0", "MiniGrid-Empty-Random-5x5-v0", "BabyAI-GoToLocalS8N7-v0"],
)
def test_frames_of_live_worlds(name: str) -> None:
    check_frames(name, 25, tile_size=8)


@pytest.mark.slow
@pytest.mark.parametrize("tile_size", [8, 32])
@pytest.mark.parametrize(
    "name",
    [
        "MiniGrid-DoorKey-8x8-v0",
        "MiniGrid-Empty-8x8-v0",
        "MiniGrid-FourRooms-v0",
        "MiniGrid-LavaCrossingS9N2-v0",
        "MiniGrid-MultiRoom-N6-v0",
        "BabyAI-GoTo-v0",
        "BabyAI-GoToDoor-v0",
    ],
)
def test_frames_of_more_live_worlds(name: str, tile_size: int) -> None:
    check_frames(name, 200, tile_size)


def test_frames_equal_those_of_env_render() -> None:
    env = gymnasium.make("MiniGrid-LavaCrossingS9N1-v0", render_mode="rgb_array")
    env.reset(seed=3)
    _, state = interop.from_minigrid(env.unwrapped)
    frame = jax.jit(lambda world: rendering.render(world, 9, 9))(state.environment)
    np.testing.assert_array_equal(frame, env.render())
    env.close()


def test_lanes_and_packed_views() -> None:
    codes = jnp.asarray(
        [
            [[tiles.tile(tiles.KEY, 2)] * 3, [tiles.tile(tiles.LOCKED_DOOR, 4)] * 3, [0, 1, 1]],
            [[tiles.tile(tiles.CLOSED_DOOR, 1)] * 3, [tiles.LAVA_TILE] * 3, [tiles.GOAL_TILE] * 3],
        ],
        jnp.uint8,
    )
    packed = jax.vmap(lambda view: rendering.render_egocentric(view, 4))(codes)
    image = jax.vmap(lambda view: rendering.render_egocentric(view, 4))(tiles.decode(codes))
    assert packed.shape == (2, 12, 12, 3)
    np.testing.assert_array_equal(packed, image)
