"""Experts within the horizon: how often they succeed, in every world that can be solved."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_search import DONE, FORWARD, LEFT, RIGHT, Model, model_of
from relaxed_search import Level, level_of

import envs_jax
from benchmarks.expert_success import follow
from envs_jax.minigrid import tiles
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.pomdp import POMDP, State


def reset(pomdp: POMDP, lanes: int) -> tuple[jax.Array, State]:
    """Returns keys and first states of so many episodes."""
    keys = jax.random.split(jax.random.key(2), lanes)
    return keys, jax.jit(jax.vmap(lambda key: pomdp.reset(key)[0]))(keys)


def without_sensors(name: str) -> POMDP:
    return replace(envs_jax.make(name), sensors={})


def walled_in(world: GridState) -> jax.Array:
    """Returns the tiles with balls in all empty cells around the agent."""
    around = jnp.indices((3, 3), jnp.int32).reshape(2, 9) - 1
    cells = tuple(world.position[:, None] + around + PADDING)
    found = world.tiles[cells]
    is_free = (found == tiles.EMPTY_TILE) & jnp.any(around != 0, axis=0)
    return world.tiles.at[cells].set(jnp.where(is_free, jnp.uint8(tiles.tile(tiles.BALL)), found))


def test_solves_errands() -> None:
    """A ball is taken out of the way, a key fetched, a door unlocked, a box picked up. Every other
    agent begins with no more room than for itself, which few of them may fail to get out of."""
    pomdp = without_sensors("MiniGrid-BlockedUnlockPickup-v0")
    keys, state = reset(pomdp, 32)
    world = state.environment
    odd = (jnp.arange(32, dtype=jnp.int32) % 2 == 1)[:, None, None]
    walled = jnp.where(odd, jax.vmap(walled_in)(world), world.tiles)
    state = replace(state, environment=replace(world, tiles=walled))
    with jax.numpy_dtype_promotion("strict"):
        record = follow(pomdp, keys, state)
    assert np.all(record.won[::2])
    assert np.sum(record.won[1::2]) >= 15


def things_of(pomdp: POMDP, lane: State) -> Model:
    """Returns the model in which the things of the first clause are to be faced."""
    model = model_of(pomdp, lane, (LEFT, RIGHT, FORWARD, DONE))
    inner = np.s_[PADDING:-PADDING, PADDING:-PADDING]
    kinds = lane.environment.tiles[inner] & tiles.TYPE_MASK
    found = (lane.environment.marks[inner] & 16 != 0) & (kinds != tiles.WALL)
    model.targets = {(int(x), int(y)) for x, y in np.argwhere(found)}
    return model


@pytest.mark.slow
def test_picks_up_what_can_be_reached_by_the_shortest_way() -> None:
    pomdp = without_sensors("BabyAI-PickupDist-v0")
    keys, state = reset(pomdp, 64)
    record = follow(pomdp, keys, state)
    compared = 0
    for lane in range(64):
        model = things_of(pomdp, jax.tree.map(lambda leaf, i=lane: np.asarray(leaf[i]), state))
        assert model.targets is not None
        best = model.shortest()
        if best is not None:
            compared += 1
            faces_one = model.front(model.start) in model.targets
            assert record.steps[lane] == (1 if faces_one else best + 1)
    assert compared >= 50


@pytest.mark.slow
def test_abstains_where_there_is_nothing_to_do() -> None:
    pomdp = without_sensors("MiniGrid-Playground-v0")
    assert np.all(follow(pomdp, *reset(pomdp, 4)).abstained)


def test_proof_of_what_cannot_be_done() -> None:
    """The agent `@`, a red key in a box `b` beside a ball `o`, and red locked doors `=`."""
    letters = {
        "#": tiles.WALL_TILE,
        "=": tiles.tile(tiles.LOCKED_DOOR),
        "b": tiles.tile(tiles.BOX, tiles.GREY),
        "o": tiles.tile(tiles.BALL),
    }

    def may_be_solved(rows: list[str], mission: str, strict: bool = False) -> bool:
        cells = {(x, y): letter for y, row in enumerate(rows) for x, letter in enumerate(row)}
        start, box = (next(c for c in cells if cells[c] == letter) for letter in "@b")
        grid = {cell: letters.get(letter, tiles.EMPTY_TILE) for cell, letter in cells.items()}
        return Level(grid, {box: tiles.RED}, start, 0, mission, strict).may_be_solved()

    before, behind = ["#######", "#@ob= #", "#######"], ["#######", "#@o =b#", "#######"]
    assert may_be_solved(before, "open the red door")
    assert not may_be_solved(before, "open the red door", strict=True)
    assert not may_be_solved(before, "open the blue door")
    assert not may_be_solved(behind, "open the red door")
    assert may_be_solved(behind, "go to a ball")
    assert not may_be_solved(behind, "pick up the grey box")


# Worlds of which some levels cannot be solved, as in the package: the key can be behind its own
# door, or be replaced by a ball; what must not be picked up can wall in what must be.
UNSOLVABLE = [
    "BabyAI-GoToImpUnlock-v0",
    "BabyAI-PickupDistDebug-v0",
    "BabyAI-Unlock-v0",
    "MiniGrid-ObstructedMaze-1Q-v0",
    "MiniGrid-ObstructedMaze-2Dlhb-v0",
    "MiniGrid-ObstructedMaze-2Q-v0",
]


@pytest.mark.slow
@pytest.mark.parametrize("name", UNSOLVABLE)
def test_abstains_only_where_nothing_helps(name: str) -> None:
    pomdp = without_sensors(name)
    keys, state = reset(pomdp, 512)
    record = follow(pomdp, keys, state)
    assert np.any(record.abstained)
    lanes = jax.tree.map(np.asarray, state)
    for lane in range(512):
        level = level_of(jax.tree.map(lambda leaf, i=lane: leaf[i], lanes), "Debug" in name)
        assert level.may_be_solved() == record.won[lane], lane
        assert record.won[lane] == ~record.abstained[lane], lane


# Shares of episodes in which the expert does not succeed. All but the last two are levels that
# cannot be solved, as in the package: the key is behind its own door, or was replaced by a ball; a
# strict target is walled in; of two strict doors, the toggle that opens the first fails the second.
# In the last two a room can be too crowded for this expert.
LOST = {
    "BabyAI-GoToImpUnlock-v0": 0.022,
    "BabyAI-OpenDoorsOrderN2Debug-v0": 2 / 3,
    "BabyAI-OpenDoorsOrderN4Debug-v0": 2 / 3,
    "BabyAI-PickupDistDebug-v0": 0.005,
    "BabyAI-Unlock-v0": 0.011,
    "MiniGrid-ObstructedMaze-1Q-v0": 0.07,
    "MiniGrid-ObstructedMaze-2Dlhb-v0": 0.07,
    "MiniGrid-ObstructedMaze-2Q-v0": 0.03,
    "BabyAI-MiniBossLevel-v0": 0.0003,
    "BabyAI-SynthS5R2-v0": 0.001,
}
EPISODES = 2000
# In the others there is nothing to do, or the expert is meant to fail.
GRIDS = ("MiniGrid-", "BabyAI-", "Advisor-")
SOLVED = [
    x
    for x in envs_jax.ids()
    if x.startswith(GRIDS) and "Playground" not in x and "CorruptExpert" not in x
]


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVED)
def test_solves_every_world_within_its_horizon(name: str) -> None:
    pomdp = without_sensors(name)
    record = follow(pomdp, *reset(pomdp, EPISODES))
    lost = LOST.get(name, 0.0)
    deviation = np.sqrt(lost * (1 - lost) / EPISODES)
    assert np.mean(~record.won) <= lost + 3 * deviation + 0.001
    # Of two strict doors the first can be opened, so there it does not abstain; nor does it where
    # rooms are too full to put anything down.
    crowded = ("BabyAI-MiniBossLevel-v0", "BabyAI-SynthS5R2-v0")
    if not name.startswith(("BabyAI-OpenDoorsOrder", *crowded)):
        assert np.mean(record.won | record.abstained) >= 0.999
