"""The experts of goal squares and GoTo: optimal, beside exhaustive search."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import minigrid  # noqa: F401  (registers its environments)
import numpy as np
import pytest
from grid_search import DONE, FORWARD, LEFT, PICKUP, RIGHT, TOGGLE, model_of
from minigrid.core.world_object import Ball, Box
from minigrid_reference import embed

import envs_jax
from envs_jax.minigrid import interop
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.samplers.babyai.one_room import GoToSampler
from envs_jax.minigrid.tasks import GoalTask, GoToTask
from jaxact.pomdp import POMDP, State

IDS = [name for name in envs_jax.ids() if name.startswith(("MiniGrid-", "BabyAI-"))]


class Runner:
    """Compiled loops for one world: random steps, and the expert until all lanes are through."""

    def __init__(self, pomdp: POMDP) -> None:
        self.pomdp = pomdp
        self.reset = jax.jit(jax.vmap(lambda key: pomdp.reset(key)[0]))
        step, advise = jax.vmap(pomdp.step), jax.vmap(pomdp.expert)

        def wander(keys: jax.Array, state: State, length: int) -> tuple[State, jax.Array]:
            def once(t: Any, carry: Any) -> Any:
                state, over = carry
                drawn = jax.vmap(lambda k: jax.random.split(jax.random.fold_in(k, t)))(keys)
                # Forward, pickup, drop and toggle more often than turns, to change the world.
                choices = jnp.array([0, 1, 2, 2, 2, 3, 4, 5], jnp.int32)
                action = jax.vmap(lambda k: jax.random.choice(k, choices))(drawn[:, 0])
                after, result = step(drawn[:, 1], state, action)
                return after, over | result.terminated

            return jax.lax.fori_loop(0, length, once, (state, jnp.zeros(len(keys), bool)))

        def follow(keys: jax.Array, state: State, limit: int) -> tuple[jax.Array, jax.Array]:
            """Returns int32[N] steps until success (`limit` if none), and whether all was valid."""

            def once(carry: Any) -> Any:
                state, over, steps, valid, t = carry
                advice = advise(keys, state)
                state, result = step(keys, state, advice.action)
                steps = jnp.where(over, steps, steps + 1)
                return state, over | result.success, steps, valid & (over | advice.valid), t + 1

            count = jnp.zeros(len(keys), jnp.int32)
            begin = (state, count < 0, count, count == 0, jnp.int32(0))
            running = lambda carry: jnp.any(~carry[1]) & (carry[-1] < limit)  # noqa: E731
            _, _, steps, valid, _ = jax.lax.while_loop(running, once, begin)
            return steps, valid

        self.wander, self.follow = jax.jit(wander), jax.jit(follow)


def count_optimal(pomdp: POMDP, state: State, results: tuple[Any, Any]) -> tuple[int, int]:
    """Compares path lengths with the shortest; returns how many are equal, and how many in all."""
    actions = (LEFT, RIGHT, FORWARD, PICKUP, TOGGLE)
    if isinstance(pomdp.task, GoToTask):
        # Moving objects about is no part of the claim; `done` is.
        actions = (LEFT, RIGHT, FORWARD, DONE)
    state, steps, valid = jax.tree.map(np.asarray, (state, *results))
    equal = compared = 0
    for lane in range(len(steps)):
        lane_state = jax.tree.map(lambda leaf, i=lane: leaf[i], state)
        best = model_of(pomdp, lane_state, actions).shortest()
        if best is not None:
            compared += 1
            equal += int(steps[lane] == best and valid[lane])
    return equal, compared


def live_states(names: list[str], size: int, seeds: int) -> State:
    """Imports live Python episodes, half of them after 25 random actions; stacked as lanes."""
    states = []
    for name in names:
        env = gymnasium.make(name).unwrapped
        for seed in range(seeds):
            env.reset(seed=seed)
            rng = np.random.default_rng(seed)
            over = False
            for action in rng.choice([0, 1, 2, 2, 2, 3, 4, 5], 25 * (seed % 2)):
                if not over:
                    _, _, over, *_ = env.step(action)
            if not over:
                pomdp, state = interop.from_minigrid(env)
                extent = pomdp.task.width, pomdp.task.height
                world = embed(state.environment, *extent, size)
                states.append(replace(state, environment=world))
        env.close()
    return jax.tree.map(lambda *leaves: np.stack(leaves), *states)


@cache
def runner_of(task: type, size: int) -> Runner:
    """Returns the loops of a world without sensors."""
    fixed = interop.FixedSampler((), None)
    return Runner(POMDP(GridWorld(size, size), task(size, size), fixed, {}))


def follow(task: type, size: int, state: State, limit: int) -> tuple[Any, Any]:
    """Follows the expert; what is missing to 64 lanes or a multiple is filled up and cut off again.

    So states of one shape share a program, however many they are.
    """
    lanes = len(state.steps)
    full = lanes + -lanes % 64
    filled = jax.tree.map(lambda leaf: leaf[np.arange(full) % lanes], state)
    with jax.numpy_dtype_promotion("strict"):
        keys = jax.random.split(jax.random.key(0), full)
        results = runner_of(task, size).follow(keys, filled, limit)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:lanes], results)


GOALS = [
    "MiniGrid-Empty-Random-6x6-v0",
    "MiniGrid-FourRooms-v0",
    "MiniGrid-DoorKey-5x5-v0",
    "MiniGrid-DoorKey-6x6-v0",
    "MiniGrid-DoorKey-8x8-v0",
    "MiniGrid-SimpleCrossingS9N3-v0",
    "MiniGrid-LavaCrossingS9N2-v0",
    "MiniGrid-LavaCrossingS11N5-v0",
]
TARGETS = ("key", "ball", "box")
GO_TO = ["BabyAI-GoToLocal-v0", "BabyAI-GoToRedBallGrey-v0"]


@pytest.mark.parametrize("names", [GOALS, GO_TO], ids=["goals", "go to"])
def test_paths_are_shortest_in_live_worlds(names: list[str]) -> None:
    task, size = (GoalTask, 19) if names is GOALS else (GoToTask, 8)
    state = live_states(names, size, seeds=30)
    results = follow(task, size, state, 200)
    equal, compared = count_optimal(runner_of(task, size).pomdp, state, results)
    assert equal == compared
    assert compared >= max(40, 0.9 * len(state.steps))


def test_carries_off_what_blocks_every_way() -> None:
    """The agent is walled in by balls in a corner, with empty and with full hands."""
    env = gymnasium.make("BabyAI-GoToObj-v0").unwrapped
    states = []
    for held in (None, Ball("green")):
        env.reset(seed=0)
        target = next(thing for thing in env.grid.grid if thing and thing.type in TARGETS)
        env.grid.set(*target.cur_pos, None)
        for x, y, thing in [(2, 1, Ball("red")), (2, 2, Ball("red")), (1, 3, Box("grey"))]:
            env.grid.set(x, y, thing)
        env.grid.set(4, 4, target)
        target.cur_pos = (4, 4)
        env.instrs.desc.obj_poss = [(4, 4)]
        env.agent_pos, env.agent_dir, env.carrying = (1, 1), 0, held
        pomdp, state = interop.from_minigrid(env)
        states.append(state)
    env.close()
    assert (pomdp.environment, pomdp.task) == (GridWorld(8, 8), GoToTask(8, 8))
    state = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    steps, valid = follow(GoToTask, 8, state, 60)
    assert np.all(valid)
    assert np.all(steps < 30)


def check_optimal(name: str, lanes: int, wandering: int, seed: int) -> tuple[int, int]:
    """Compares paths from sampled episodes of `name`, after as many random steps."""
    pomdp = replace(envs_jax.make(name), sensors={})
    runner = Runner(pomdp)
    keys = jax.random.split(jax.random.key(seed), lanes)
    state = runner.reset(keys)
    if wandering:
        state, over = runner.wander(keys, state, wandering)
        going = np.flatnonzero(~np.asarray(over))
        keys, state = keys[going], jax.tree.map(lambda leaf: leaf[going], state)
    results = runner.follow(keys, state, 4 * int(state.horizon[0]))
    return count_optimal(pomdp, state, results)


def has_many_doors(name: str) -> bool:
    """Whether there are too many doors to open and shut for an exhaustive search."""
    pomdp = envs_jax.make(name)
    in_maze = isinstance(pomdp.task, GoToTask) and not isinstance(pomdp.sampler, GoToSampler)
    return in_maze or name.startswith(("MiniGrid-MultiRoom", "MiniGrid-LockedRoom"))


OPTIMAL_IDS = [
    name
    for name in envs_jax.ids()
    if name.startswith(("MiniGrid-", "BabyAI-"))
    and isinstance(envs_jax.make(name).task, GoalTask | GoToTask)
]


# 50 ids.
SEARCHED_IDS = [name for name in OPTIMAL_IDS if not has_many_doors(name)]


@pytest.mark.slow
@pytest.mark.parametrize("name", SEARCHED_IDS)
def test_paths_of_fresh_episodes_are_shortest(name: str) -> None:
    equal, compared = check_optimal(name, 250, wandering=0, seed=5)
    assert equal == compared == 250


@pytest.mark.slow
@pytest.mark.parametrize("name", SEARCHED_IDS)
def test_paths_from_what_was_changed_at_random_are_shortest(name: str) -> None:
    equal, compared = check_optimal(name, 400, wandering=40, seed=1)
    assert compared >= 30
    assert equal >= 0.999 * compared
