"""The WFC worlds: layouts of our own, on which everything else is the package's."""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from minigrid.core.grid import Grid
from minigrid.core.mission import MissionSpace
from minigrid.core.world_object import Goal, Wall
from minigrid.minigrid_env import MiniGridEnv
from minigrid_reference import compare, play
from scipy.ndimage import label

import envs_jax
from envs_jax.minigrid import interop, tiles
from envs_jax.minigrid.samplers import placement, wfc
from envs_jax.minigrid.state import PADDING
from jaxact.pomdp import State

COUNT = 256


@cache
def our_states(look: str) -> State:
    keys = jax.random.split(jax.random.key(0), COUNT)
    reset = envs_jax.make(f"MiniGrid-WFC-{look}-v0").reset
    return jax.device_get(jax.jit(jax.vmap(lambda key: reset(key)[0]))(keys))


def kinds_of(look: str) -> np.ndarray:
    """Returns the tile types [level, x, y]."""
    return our_states(look).environment.tiles[:, PADDING:-PADDING, PADDING:-PADDING] & 15


class OurLayouts(MiniGridEnv):
    """The package's environment on our layouts, chosen by the seed."""

    def __init__(self, look: str) -> None:
        self._states = our_states(look)
        self._kinds = kinds_of(look)
        mission_space = MissionSpace(mission_func=lambda: wfc.MISSION)
        super().__init__(mission_space=mission_space, width=25, height=25, max_steps=500)

    def _gen_grid(self, width: int, height: int) -> None:
        level = self._rand_int(0, COUNT)
        self.grid = Grid(width, height)
        for x, y in np.ndindex(width, height):
            thing = {tiles.WALL: Wall, tiles.GOAL: Goal}.get(self._kinds[level, x, y])
            if thing is not None:
                self.put_obj(thing(), x, y)
        world = self._states.environment
        self.agent_pos, self.agent_dir = tuple(world.position[level]), int(world.direction[level])
        self.mission = wfc.MISSION


@pytest.mark.parametrize("look", wfc.LOOKS)
def test_open_cells_are_one_part_with_one_goal_and_walls_round_it(look: str) -> None:
    world = our_states(look).environment
    for kinds, (x, y) in zip(kinds_of(look), world.position, strict=True):
        assert set(np.unique(kinds)) == {tiles.EMPTY, tiles.WALL, tiles.GOAL}
        assert (kinds == tiles.GOAL).sum() == 1
        assert kinds[x, y] == tiles.EMPTY
        assert label(kinds != tiles.WALL)[1] == 1
        border = np.concatenate([kinds[[0, -1]].ravel(), kinds[:, [0, -1]].ravel()])
        assert (border == tiles.WALL).all()
    assert len({kinds.tobytes() for kinds in kinds_of(look)}) == COUNT
    # There is something to go through, and something to go round.
    room = (kinds_of(look) != tiles.WALL).mean(axis=(1, 2))
    assert room.min() > 0.1
    assert 0.4 < room.mean() < 0.8


def test_agent_and_goal_are_anywhere_in_any_order_facing_anywhere() -> None:
    world, kinds = our_states("ObstaclesBlackdots").environment, kinds_of("ObstaclesBlackdots")
    goals = np.argwhere(kinds == tiles.GOAL)[:, 1:]
    for cells in (world.position, goals):
        quarters = Counter(map(tuple, (cells > 12).tolist()))
        assert len(quarters) == 4
        assert min(quarters.values()) > COUNT / 8
    directions = Counter(world.direction.tolist())
    assert set(directions) == {0, 1, 2, 3}
    assert min(directions.values()) > COUNT / 8


@pytest.mark.parametrize(("look", "room"), [("MazeSimple", 1), ("DungeonMazeScaled", 2)])
def test_mazes_lose_no_room(look: str, room: int) -> None:
    inside = kinds_of(look)[:, 1:-1, 1:-1] != tiles.WALL
    step = room + 1
    for x in range(room):
        for y in range(room):
            assert inside[:, x::step, y::step].all()
    assert not inside[:, room::step, room::step].any()


@pytest.mark.parametrize("look", wfc.LOOKS)
def test_worlds_agree_with_the_packages_dynamics_step_by_step(look: str) -> None:
    rng = np.random.default_rng(0)
    env = OurLayouts(look)
    recordings = [play(env, rng, seed=seed, prefix=0, scrambled=seed % 2 == 1) for seed in range(8)]
    assert compare(recordings, size=25) == 8 * 48


@pytest.mark.parametrize("look", wfc.LOOKS)
def test_a_made_world_is_the_imported_one(look: str) -> None:
    env = OurLayouts(look)
    env.reset(seed=0)
    pomdp, state = interop.from_minigrid(env)
    made = envs_jax.make(f"MiniGrid-WFC-{look}-v0")
    assert (pomdp.environment, pomdp.task) == (made.environment, made.task)
    assert pomdp.sensors == made.sensors
    begun = jax.tree.map(lambda leaves: leaves[0], our_states(look))
    assert jax.tree.structure(begun) == jax.tree.structure(state)
    assert state.horizon == begun.horizon == 500
    np.testing.assert_array_equal(state.task.mission, begun.task.mission)


def test_the_largest_component_is_that_of_a_labelling() -> None:
    rng = np.random.default_rng(0)
    planes: Any = rng.random((200, 14, 11)) < rng.uniform(0.2, 0.8, (200, 1, 1))
    planes[0], planes[1] = False, True
    largest = np.asarray(jax.jit(jax.vmap(placement.largest_component))(jnp.asarray(planes)))
    for free, found in zip(planes, largest, strict=True):
        parts, count = label(free)
        sizes = np.bincount(parts.ravel())[1:]
        assert found.sum() == sizes.max(initial=0)
        if count:
            assert len(np.unique(parts[found])) == 1
            assert (parts[found] > 0).all()
