"""Experts that know what the agent has seen: what they do, and that they know no more."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_expert_success import reset

import envs_jax
from benchmarks.expert_success import follow
from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import FORWARD, PICKUP, RIGHT, TOGGLE
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.partial_expert import PartialState, partially_observing
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.sensors import PackedImageSensor
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, GridState
from envs_jax.minigrid.tasks import GoalState
from jaxact import JaxactError
from jaxact.pomdp import State
from jaxact.samplers.level_replay import PrioritizedLevelReplay
from jaxact.testing import check_pomdp

SIZE = 8
LANES = 8
CODES = {
    "#": tiles.WALL_TILE,
    ".": tiles.EMPTY_TILE,
    "G": tiles.GOAL_TILE,
    "D": tiles.tile(tiles.CLOSED_DOOR, tiles.BLUE),
    "L": tiles.tile(tiles.LOCKED_DOOR, tiles.RED),
    "B": tiles.tile(tiles.BOX, tiles.GREEN),
}
RED_KEY_INSIDE = (tiles.RED + 1) << CONTENTS_SHIFT


def drawn(picture: str, position: tuple[int, int], direction: int, contents: int = 0) -> State:
    """Returns the first state in a world drawn line by line; `contents` are those of its boxes."""
    rows = picture.split()
    plane = jnp.array([[CODES[row[x]] for row in rows] for x in range(SIZE)], jnp.uint8)
    world = placement.grid_state(plane, jnp.array(position, jnp.int32), jnp.int32(direction))
    is_box = world.tiles & tiles.TYPE_MASK == tiles.BOX
    world = replace(world, marks=jnp.where(is_box, jnp.uint16(contents), world.marks))
    seen = planner.pack(PackedImageSensor(SIZE, SIZE).visible(world))
    goal = GoalState(jnp.int32(0), jnp.int32(640), jnp.asarray(encode_mission("get to the goal")))
    return State(world, PartialState(goal, seen), jnp.int32(0), jnp.int32(640), None)


@functools.cache
def compiled() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Returns the expert and the step of a world of 8 × 8 cells, both for `LANES` lanes."""
    pomdp = partially_observing(envs_jax.make("MiniGrid-DoorKey-8x8-v0"))
    pomdp = replace(pomdp, sensors={})
    return jax.jit(jax.vmap(pomdp.expert)), jax.jit(jax.vmap(pomdp.step))


def play(state: State, length: int) -> list[int | None]:
    """Follows the expert to the goal; returns its actions, at the end None where it has none."""
    advise, step = compiled()
    keys = jax.random.split(jax.random.key(0), LANES)
    lanes = jax.tree.map(lambda leaf: jnp.stack([leaf] * LANES), state)
    actions: list[int | None] = []
    for _ in range(length):
        advice = advise(keys, lanes)
        if not advice.valid[0]:
            return [*actions, None]
        actions.append(int(advice.action[0]))
        lanes, result = step(keys, lanes, advice.action)
        if result.success[0]:
            break
    return actions


TWO_ROOMS = """
    ########
    #..#...#
    #..#...#
    #..{}...#
    #..#...#
    #..#..G#
    #{}.#...#
    ########
"""


def test_it_looks_round_opens_a_door_and_finds_the_goal() -> None:
    actions = play(drawn(TWO_ROOMS.format("D", "."), (1, 3), 0), 40)
    # Behind it first; the door is two steps away, the goal in sight as soon as that is open.
    assert actions == [0, 0, 0, 0, FORWARD, TOGGLE, *[FORWARD] * 4, RIGHT, FORWARD, FORWARD]


@pytest.mark.parametrize("contents", [RED_KEY_INSIDE, 0])
def test_it_opens_a_box_when_nothing_else_is_left(contents: int) -> None:
    actions = play(drawn(TWO_ROOMS.format("L", "B"), (1, 3), 0, contents), 60)
    opened = actions.index(TOGGLE)
    assert PICKUP not in actions[:opened]
    if contents:
        assert actions[opened + 1] == PICKUP
        assert actions.count(TOGGLE) == 2
        assert actions[-1] == FORWARD
    else:
        assert actions[opened + 1 :] == [None]


def changed(rng: np.random.Generator, world: GridState, seen: np.ndarray) -> GridState:
    """Returns worlds in which other things are in all unseen cells, and in all boxes."""
    width = world.tiles.shape[1] - 2 * PADDING
    is_seen = seen[:, None, :] >> np.arange(width)[:, None] & 1 != 0
    is_seen = np.pad(is_seen, [(0, 0), (PADDING, PADDING), (PADDING, PADDING)], constant_values=1)
    plane, marks = np.asarray(world.tiles), np.asarray(world.marks)
    plane = np.where(is_seen, plane, random_tiles(rng, plane.shape))
    marks = np.where(is_seen, marks, rng.integers(0, 256, marks.shape))
    inside = rng.integers(0, tiles.NUM_COLORS + 1, marks.shape) << CONTENTS_SHIFT
    marks = np.where(plane & tiles.TYPE_MASK == tiles.BOX, marks & 255 | inside, marks)
    return replace(world, tiles=jnp.asarray(plane), marks=jnp.asarray(marks, jnp.uint16))


def random_tiles(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    kinds = rng.choice([1, 1, 1, 1, 1, 1, 1, 1, 2, 4, 5, 6, 7, 8, 9, 11, 12], shape)
    return (kinds | rng.integers(0, tiles.NUM_COLORS, shape) << tiles.COLOR_SHIFT).astype(np.uint8)


def test_what_is_unseen_does_not_change_the_advice() -> None:
    """Random worlds of which the cells round the agent and a random half are known."""
    rng = np.random.default_rng(0)
    advise, _ = compiled()
    keys = jax.random.split(jax.random.key(0), LANES)
    empty = drawn(TWO_ROOMS.format(".", "."), (1, 3), 0)
    state = jax.tree.map(lambda leaf: jnp.stack([leaf] * LANES), empty)
    said = []
    for _ in range(40):
        plane = np.asarray(state.environment.tiles).copy()
        inner = np.s_[:, PADDING + 1 : -PADDING - 1, PADDING + 1 : -PADDING - 1]
        plane[inner] = random_tiles(rng, plane[inner].shape)
        seen = rng.integers(0, 256, (LANES, SIZE), dtype=np.uint8)
        position = rng.integers(1, SIZE - 1, (LANES, 2))
        for lane, (x, y) in enumerate(position):
            plane[lane, x + PADDING, y + PADDING] = tiles.EMPTY_TILE
            seen[lane, y - 1 : y + 2] |= np.uint8(7 << (x - 1))
        world = replace(
            state.environment,
            tiles=jnp.asarray(plane),
            position=jnp.asarray(position, jnp.int32),
            direction=jnp.asarray(rng.integers(0, 4, LANES), jnp.int32),
            carrying=jnp.asarray(rng.choice([0, 5, 21, 6], LANES), jnp.uint8),
        )
        state = replace(state, environment=world, task=replace(state.task, seen=jnp.asarray(seen)))
        other = replace(state, environment=changed(rng, world, seen))
        with jax.numpy_dtype_promotion("strict"):
            one, two = advise(keys, state), advise(keys, other)
        np.testing.assert_array_equal(one.valid, two.valid)
        valid = np.asarray(one.valid)
        np.testing.assert_array_equal(one.action[valid], two.action[valid])
        said += [*np.asarray(one.action)[valid]]
    assert len(said) > 100
    assert len(set(said)) > 4


def test_worlds_without_such_an_expert_are_refused() -> None:
    with pytest.raises(JaxactError, match="the expert of ObstacleTask cannot be told"):
        partially_observing(envs_jax.make("MiniGrid-Dynamic-Obstacles-5x5-v0"))
    pomdp = envs_jax.make("MiniGrid-Empty-8x8-v0", observation="full")
    with pytest.raises(JaxactError, match="needs a sensor 'image' of the agent's own view"):
        partially_observing(pomdp)
    with pytest.raises(JaxactError, match="needs a sensor 'image'"):
        partially_observing(replace(pomdp, sensors={}))
    pomdp = envs_jax.make("MiniGrid-Empty-8x8-v0")
    pomdp = replace(pomdp, sampler=PrioritizedLevelReplay(pomdp.sampler))
    with pytest.raises(JaxactError, match="PrioritizedLevelReplay learns"):
        partially_observing(pomdp)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["BabyAI-BossLevel-v0", "MiniGrid-MemoryS13-v0"])
def test_what_is_unseen_does_not_change_the_advice_in_play(name: str) -> None:
    """Episodes after random steps; what was not seen is taken from another one."""
    pomdp = partially_observing(envs_jax.make(name))
    check_pomdp(pomdp, lanes=2, steps=4)
    pomdp = replace(pomdp, sensors={})
    keys, state = reset(pomdp, 64)
    advise, step = jax.jit(jax.vmap(pomdp.expert)), jax.jit(jax.vmap(pomdp.step))
    rng = np.random.default_rng(0)
    for _ in range(40):
        seen = np.asarray(state.task.seen)
        other = replace(state, environment=changed(rng, state.environment, seen))
        one, two = advise(keys, state), advise(keys, other)
        np.testing.assert_array_equal(one.valid, two.valid)
        np.testing.assert_array_equal(one.action[one.valid], two.action[one.valid])
        choices = rng.choice([0, 1, 2, 2, 2, 3, 4, 5], 64)
        action = np.where(rng.random(64) < 0.5, np.asarray(one.action), choices)
        state, _ = step(keys, state, jnp.asarray(action, jnp.int32))


# Least success and greatest mean length of the episodes with success; in `Unlock` the key can be
# behind its own door.
FIGURES = {
    "MiniGrid-Empty-8x8-v0": (1.0, 15.0),
    "MiniGrid-FourRooms-v0": (0.995, 35.0),
    "MiniGrid-DoorKey-8x8-v0": (0.995, 20.5),
    "BabyAI-GoToLocal-v0": (0.995, 6.0),
    "BabyAI-GoTo-v0": (0.995, 52.0),
    "BabyAI-KeyInBox-v0": (0.995, 23.0),
    "BabyAI-Unlock-v0": (0.98, 84.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(FIGURES))
def test_it_gets_there_within_the_horizon(name: str) -> None:
    pomdp = replace(partially_observing(envs_jax.make(name)), sensors={})
    record = follow(pomdp, *reset(pomdp, 500))
    success, length = FIGURES[name]
    assert np.mean(record.won) >= success
    assert np.mean(record.steps[record.won]) <= length
