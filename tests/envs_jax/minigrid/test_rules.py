"""What ends an episode of MiniGrid's other worlds, in scenes set up by hand, beside the package."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from minigrid.core.world_object import Ball, Box, Key
from minigrid_reference import python_env

import envs_jax
from envs_jax.minigrid import interop
from jaxact.pomdp import POMDP, State, Step

LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(7)
GOES_ON, FAILS, SUCCEEDS = "goes on", "fails", "succeeds"


def world(name: str, seed: int = 0) -> Any:
    env = python_env(name)
    env.reset(seed=seed)
    return env


def stand(env: Any, cell: tuple[int, int], direction: int) -> None:
    env.agent_pos, env.agent_dir = cell, direction


def clear(env: Any) -> None:
    """Removes all that can be carried."""
    for index, thing in enumerate(env.grid.grid):
        if thing is not None and thing.can_pickup():
            env.grid.grid[index] = None


@partial(jax.jit, static_argnums=0)
def step_of(pomdp: POMDP, state: State, action: np.int32) -> tuple[State, Step]:
    return pomdp.step(jax.random.key(0), state, action)


def outcomes(env: Any, *actions: int) -> list[str]:
    """Takes the actions in the package and here; returns what each came to, the same in both."""
    pomdp, state = interop.from_minigrid(env)
    # Neither sampler nor sensors have a say in it; without them worlds share a program.
    pomdp = replace(pomdp, sampler=None, sensors={})
    results = []
    for action in actions:
        _, reward, terminated, *_ = env.step(action)
        state, step = step_of(pomdp, state, np.int32(action))
        assert step.reward == pytest.approx(reward, abs=1e-6)
        assert bool(step.terminated) == terminated
        assert bool(step.success) == (reward > 0)
        results.append(SUCCEEDS if reward > 0 else FAILS if terminated else GOES_ON)
    return results


@pytest.mark.parametrize(
    ("thing", "result"), [("target", SUCCEEDS), ("other", FAILS), ("box", FAILS)]
)
def test_fetch(thing, result):
    env = world("MiniGrid-Fetch-5x5-N2-v0")
    kinds = {"key": Key, "ball": Ball}
    target = kinds.pop(env.targetType)(env.targetColor)
    (other,) = kinds.values()
    things = {"target": target, "other": other(env.targetColor), "box": Box(env.targetColor)}
    clear(env)
    env.put_obj(things[thing], 2, 1)
    stand(env, (1, 1), 0)
    assert outcomes(env, TOGGLE if thing != "box" else DONE, PICKUP, LEFT) == [
        GOES_ON,
        result,
        result,
    ]


@pytest.mark.parametrize("name", ["MiniGrid-GoToDoor-8x8-v0", "MiniGrid-GoToObject-6x6-N2-v0"])
def test_go_next_to(name):
    env = world(name)
    clear(env)
    env.target_pos = (2, 2)
    stand(env, (2, 3), 2)
    assert outcomes(env, DONE, RIGHT, TOGGLE, PICKUP, DROP) == [
        SUCCEEDS,
        GOES_ON,
        FAILS,
        GOES_ON,
        GOES_ON,
    ]
    for cell in ((3, 3), (2, 2), (2, 4)):
        stand(env, cell, 0)
        assert outcomes(env, DONE) == [FAILS]


def test_put_near():
    env = world("MiniGrid-PutNear-8x8-N3-v0")
    clear(env)
    wanted = {"key": Key, "ball": Ball, "box": Box}[env.move_type](env.moveColor)
    env.target_pos = (4, 4)
    for cell, result in (((2, 3), SUCCEEDS), ((2, 2), FAILS), ((1, 4), FAILS)):
        stand(env, cell, 0)
        env.carrying = wanted
        assert outcomes(env, DROP, PICKUP, DROP) == [result, GOES_ON, result]
    # In vain, and yet the end.
    stand(env, (6, 2), 0)
    env.carrying = wanted
    assert outcomes(env, PICKUP, DROP, LEFT) == [GOES_ON, FAILS, GOES_ON]
    env.carrying = None
    assert outcomes(env, DROP) == [GOES_ON]
    env.put_obj(Key("red" if env.moveColor != "red" else "blue"), 6, 1)
    assert outcomes(env, PICKUP, PICKUP) == [FAILS, FAILS]


@pytest.mark.parametrize("size", [7, 13])
def test_match(size):
    env = world(f"MiniGrid-MemoryS{size}-v0")
    inward = {env.success_pos: SUCCEEDS, env.failure_pos: FAILS}
    for cell, result in inward.items():
        middle = size // 2
        direction = 3 if cell[1] < middle else 1
        stand(env, (cell[0], middle), direction)
        assert outcomes(env, *[FORWARD] * abs(middle - cell[1])) == [result]
        # Taking things in hand does nothing.
        assert outcomes(env, PICKUP, LEFT) == [result, result]
        assert env.carrying is None
    clear(env)
    door_key = Box("green", Key("green"))
    env.put_obj(door_key, 1, size // 2)
    stand(env, (2, size // 2), 2)
    assert outcomes(env, PICKUP, TOGGLE, PICKUP) == [GOES_ON] * 3


@pytest.mark.parametrize(
    ("red", "blue", "ahead", "result"),
    [
        (True, False, "blue", [SUCCEEDS, FAILS]),
        (False, False, "blue", [FAILS, GOES_ON]),
        (False, False, "red", [GOES_ON, GOES_ON]),
        (False, True, "red", [FAILS, SUCCEEDS]),
        (True, True, "blue", [FAILS, SUCCEEDS]),
    ],
)
def test_open_in_turn(red, blue, ahead, result):
    env = world("MiniGrid-RedBlueDoors-6x6-v0")
    env.red_door.is_open, env.blue_door.is_open = red, blue
    (y,) = (
        index // env.width
        for index, thing in enumerate(env.grid.grid)
        if thing is (env.blue_door if ahead == "blue" else env.red_door)
    )
    stand(env, (7, y) if ahead == "blue" else (4, y), 0 if ahead == "blue" else 2)
    assert outcomes(env, TOGGLE, TOGGLE) == result


def test_open():
    env = world("MiniGrid-Unlock-v0")
    x, y = env.door.cur_pos
    clear(env)
    stand(env, (x - 1, y), 0)
    assert outcomes(env, TOGGLE) == [GOES_ON]
    env.carrying = Key(env.door.color)
    assert outcomes(env, TOGGLE, LEFT, TOGGLE, RIGHT, TOGGLE) == [
        SUCCEEDS,
        GOES_ON,
        SUCCEEDS,
        GOES_ON,
        GOES_ON,
    ]


@pytest.mark.parametrize(
    "name",
    [
        "MiniGrid-UnlockPickup-v0",
        "MiniGrid-KeyCorridorS4R3-v0",
        "MiniGrid-ObstructedMaze-2Dlhb-v1",
    ],
)
def test_pick_up(name):
    env = world(name)
    wanted = env.obj
    clear(env)
    twin = type(wanted)(wanted.color)
    for thing, result in ((wanted, SUCCEEDS), (twin, GOES_ON)):
        env.carrying = None
        env.agent_pos = next(
            (x, y)
            for x in range(1, env.width - 2)
            for y in range(1, env.height - 1)
            if env.grid.get(x, y) is None and env.grid.get(x + 1, y) is None
        )
        env.agent_dir = 0
        env.put_obj(thing, env.agent_pos[0] + 1, env.agent_pos[1])
        # A second attempt with the hands full counts as well, as in the package.
        assert outcomes(env, PICKUP, LEFT, PICKUP) == [result, GOES_ON, result]


def test_rules_share_a_batch():
    """Worlds of one shape that differ in their rules are one program."""
    names = ["MiniGrid-Fetch-8x8-N3-v0", "MiniGrid-PutNear-8x8-N3-v0", "MiniGrid-GoToDoor-8x8-v0"]
    pomdps = [envs_jax.make(name) for name in names]
    states = [jax.jit(pomdp.reset)(jax.random.key(1))[0] for pomdp in pomdps]
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    step = jax.vmap(pomdps[0].step, in_axes=(None, 0, None))
    together, _ = jax.jit(step)(jax.random.key(0), batch, np.int32(TOGGLE))
    for lane, (pomdp, state) in enumerate(zip(pomdps, states, strict=True)):
        alone, _ = jax.jit(pomdp.step)(jax.random.key(0), state, np.int32(TOGGLE))
        for ours, other in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_array_equal(ours, other[lane])
