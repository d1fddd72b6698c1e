"""The expert of errands: how often it gets them done in time, and how straight it goes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_search import DONE, FORWARD, LEFT, RIGHT, Model, model_of

import envs_jax
from envs_jax.minigrid import tiles
from envs_jax.minigrid.obstacles import ObstacleTask
from envs_jax.minigrid.rules import ErrandTask
from envs_jax.minigrid.state import PADDING
from envs_jax.minigrid.tasks import DemonstratedInstructionTask
from jaxact.pomdp import POMDP, State


def reset(pomdp: POMDP, lanes: int) -> tuple[jax.Array, State]:
    """Returns keys and first states of so many episodes."""
    keys = jax.random.split(jax.random.key(2), lanes)
    return keys, jax.jit(jax.vmap(lambda key: pomdp.reset(key)[0]))(keys)


def follow(pomdp: POMDP, keys: jax.Array, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Follows the expert to the end of each episode.

    Returns bool[N], whether it ended with success, and int32[N], after how many steps.
    """
    step, advise = jax.vmap(pomdp.step), jax.vmap(pomdp.expert)

    def once(carry: Any) -> Any:
        state, over, won, steps, t = carry
        drawn = jax.vmap(lambda key: jax.random.fold_in(key, t))(keys)
        state, result = step(drawn, state, advise(drawn, state).action)
        won = won | (~over & result.success)
        steps = jnp.where(over, steps, steps + 1)
        return state, over | result.terminated | result.truncated, won, steps, t + 1

    no = jnp.zeros(len(keys), bool)
    begin = (state, no, no, jnp.zeros(len(keys), jnp.int32), jnp.int32(0))
    run = jax.jit(lambda begin: jax.lax.while_loop(lambda c: ~jnp.all(c[1]), once, begin))
    _, _, won, steps, _ = run(begin)
    return np.asarray(won), np.asarray(steps)


def without_sensors(name: str) -> POMDP:
    return replace(envs_jax.make(name), sensors={})


SAMPLE = [
    "BabyAI-PickupDist-v0",
    "BabyAI-UnlockPickupDist-v0",
    "MiniGrid-BlockedUnlockPickup-v0",
    "MiniGrid-Dynamic-Obstacles-6x6-v0",
    "MiniGrid-MemoryS7-v0",
    "MiniGrid-ObstructedMaze-1Dlhb-v0",
    "MiniGrid-PutNear-6x6-N2-v0",
    "MiniGrid-RedBlueDoors-6x6-v0",
]


@pytest.mark.parametrize("name", SAMPLE)
def test_solves_errands(name: str) -> None:
    pomdp = without_sensors(name)
    keys, state = reset(pomdp, 32)
    with jax.numpy_dtype_promotion("strict"):
        won, _ = follow(pomdp, keys, state)
    assert np.all(won)


def things_of(pomdp: POMDP, lane: State) -> Model:
    """Returns the model in which the things of the first clause are to be faced."""
    model = model_of(pomdp, lane, (LEFT, RIGHT, FORWARD, DONE))
    inner = np.s_[PADDING:-PADDING, PADDING:-PADDING]
    kinds = lane.environment.tiles[inner] & tiles.TYPE_MASK
    found = (lane.environment.marks[inner] & 16 != 0) & (kinds != tiles.WALL)
    model.targets = {(int(x), int(y)) for x, y in np.argwhere(found)}
    return model


@pytest.mark.parametrize("name", ["BabyAI-PickupDist-v0"])
def test_picks_up_what_can_be_reached_by_the_shortest_way(name: str) -> None:
    pomdp = without_sensors(name)
    keys, state = reset(pomdp, 64)
    _, steps = follow(pomdp, keys, state)
    compared = 0
    for lane in range(64):
        model = things_of(pomdp, jax.tree.map(lambda leaf, i=lane: np.asarray(leaf[i]), state))
        assert model.targets is not None
        best = model.shortest()
        if best is not None:
            compared += 1
            faces_one = model.front(model.start) in model.targets
            assert steps[lane] == (1 if faces_one else best + 1)
    assert compared >= 50


def test_worlds_beyond_the_expert_do_not_offer_one() -> None:
    for name in ("MiniGrid-Playground-v0", "MiniGrid-KeyCorridorS3R1-v0", "BabyAI-BossLevel-v0"):
        assert not envs_jax.make(name).has_expert


EXPERTS = (ErrandTask, DemonstratedInstructionTask, ObstacleTask)
ERRANDS = [
    name
    for name in envs_jax.ids()
    if name.startswith(("MiniGrid-", "BabyAI-"))
    and isinstance(
        envs_jax.make(name).task, ErrandTask | DemonstratedInstructionTask | ObstacleTask
    )
]
# Least success rates where some levels cannot be solved, all of them as in the package: a key
# behind its own door; a strict target behind other objects.
UNSOLVABLE = {
    "BabyAI-Unlock-v0": 0.95,
    "BabyAI-GoToImpUnlock-v0": 0.94,
    "BabyAI-PickupDistDebug-v0": 0.96,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ERRANDS)
def test_solves_all_errands(name: str) -> None:
    pomdp = without_sensors(name)
    won, _ = follow(pomdp, *reset(pomdp, 1000))
    assert np.mean(won) >= UNSOLVABLE.get(name, 0.999)
