"""The stag hunt against its rules in plain Python, from thousands of states."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.social import StagHunt, grid
from envs_jax.social.stag_hunt import StagHuntState
from jaxact import JaxactError
from jaxact.agents import MixedRewards
from jaxact.testing import check_pomdp
from tests.envs_jax.social.stag_hunt_rules import body, outcomes, stag_moves, stag_places

VARIANTS = {
    "as by default": {},
    "a large stag that flees": {"stag_side": 2, "flees": True},
    "three of five take one that wanders": {
        "stag": "wanders",
        "agents": 5,
        "hunters": 3,
        "size": 4,
        "stag_side": 2,
    },
    "a small field": {"size": 3, "starts": "anywhere", "maul_penalty": 0.5},
}


def cells(array):
    return [tuple(map(int, cell)) for cell in np.asarray(array).reshape(-1, 2)]


def standing(agents, stag):
    plants, nobody = jnp.int32([[0, 4], [4, 0]]), jnp.zeros(2, bool)
    return StagHuntState(jnp.int32(agents), jnp.int32(stag), plants, nobody, nobody)


@pytest.mark.parametrize("name", VARIANTS)
def test_every_step_is_one_that_the_rules_allow(name):
    pomdp = envs_jax.make("Markov-StagHunt-v0", horizon=20, **VARIANTS[name])
    world, task = pomdp.environment, pomdp.task
    lanes, steps = 40, 30
    state, _ = jax.vmap(pomdp.reset)(jax.random.split(jax.random.key(0), lanes))
    step = jax.jit(jax.vmap(pomdp.step))
    seen = {"caught": 0, "mauled": 0, "eaten": 0}
    for t in range(steps):
        keys = jax.random.split(jax.random.key(t), lanes)
        action = jax.vmap(pomdp.action_space.sample)(keys)
        before, (state, result) = state, step(keys, state, action)
        for lane in range(lanes):
            old, new = (jax.tree.map(lambda x, i=lane: np.asarray(x)[i], s.environment)
                        for s in (before, state))  # fmt: skip
            agents, plants = cells(old.agents), cells(old.plants)
            (stag,), (new_stag,) = cells(old.stag), cells(new.stag)
            rewards = np.asarray(result.reward)[lane]
            fits = []
            possible = outcomes(agents, stag, plants, np.asarray(action)[lane], world, task)
            for after, goes_to, expected, anew, eaten in possible:
                taken = {*after, *plants, *body(goes_to, world.stag_side)}
                free = new_stag in stag_places(taken, world)
                fits.append(
                    after == cells(new.agents)
                    and np.allclose(expected, rewards)
                    and (free if anew else new_stag == goes_to)
                    and all(
                        q not in {*after, *plants, *body(new_stag, world.stag_side)}
                        if e
                        else p == q
                        for p, q, e in zip(plants, cells(new.plants), eaten, strict=True)
                    )
                )
                if fits[-1]:
                    seen["caught"] += max(expected) == task.stag_reward
                    seen["mauled"] += min(expected) < 0
                    seen["eaten"] += any(eaten)
            assert any(fits), (t, lane, old, new, rewards)
    assert min(seen.values()) > 0, seen


def test_the_stag_takes_each_allowed_move_as_often():
    world = StagHunt()
    state = standing([[0, 0], [4, 4]], [2, 1])
    keys = jax.random.split(jax.random.key(0), 4000)
    after = jax.jit(jax.vmap(world.step, (0, None, None)))(keys, state, jnp.int32([0, 3]))
    found, counts = np.unique(np.asarray(after.stag), axis=0, return_counts=True)
    assert set(cells(found)) == stag_moves((2, 1), [(0, 0), (4, 4)], world) == {(1, 1), (2, 0)}
    assert counts.min() > 1850  # 2000, give or take 5 deviations


def test_what_comes_up_is_anywhere_free_and_equally_likely():
    world = StagHunt()
    state = standing([[2, 1], [2, 3]], [2, 2])
    world = dataclasses.replace(world, stag="stands")
    keys = jax.random.split(jax.random.key(0), 22_000)
    after = jax.jit(jax.vmap(world.step, (0, None, None)))(keys, state, jnp.int32([1, 3]))
    assert bool(jnp.all(after.at_stag))
    found, counts = np.unique(np.asarray(after.stag), axis=0, return_counts=True)
    assert len(found) == 22  # 25 without both agents' cell and the two plants
    assert abs(counts - 1000).max() < 160


@pytest.mark.parametrize(
    "name", ["Markov-StagHunt-v0", "Markov-Harvest-v0", "Markov-Escalation-v0"]
)
def test_the_worlds_are_sound(name):
    pomdp = envs_jax.make(name)
    check_pomdp(pomdp)
    state, observation = pomdp.reset(jax.random.key(0))
    seen = np.asarray(observation["map"])
    assert seen[0, ..., 0].sum() == seen[0, ..., 1].sum() == 1
    np.testing.assert_array_equal(seen[0, ..., 0], seen[1, ..., 1])
    np.testing.assert_array_equal(seen[0, ..., 2:], seen[1, ..., 2:])
    picture = np.asarray(pomdp.pictures(state)["map"])
    assert picture.dtype == np.uint8
    assert picture.std() > 0


def test_what_cannot_be_is_refused():
    with pytest.raises(JaxactError, match="unknown stag 'follow'; the nearest is 'follows'"):
        envs_jax.make("Markov-StagHunt-v0", stag="follow")
    with pytest.raises(JaxactError, match="no room for 2 agents, 2 plants and a stag of 2×2"):
        envs_jax.make("Markov-StagHunt-v0", size=2, stag_side=2)
    with pytest.raises(JaxactError, match="unknown start 'anywere'"):
        envs_jax.make("Markov-StagHunt-v0", starts="anywere")
    pomdp = envs_jax.make("Markov-StagHunt-v0")
    with pytest.raises(JaxactError, match="takes 3 hunters, the environment's 2"):
        dataclasses.replace(pomdp, task=dataclasses.replace(pomdp.task, hunters=3))
    with pytest.raises(JaxactError, match="agents of a stag hunt must be at least 1, got 0"):
        envs_jax.make("Markov-StagHunt-v0", agents=0)
    with pytest.raises(JaxactError, match=r"by 3 agent\(s\): hunters must be 1 to 3"):
        envs_jax.make("Markov-StagHunt-v0", agents=3, hunters=4)
    with pytest.raises(JaxactError, match="hunters of a stag hunt must be at least 1, got 0"):
        envs_jax.make("Markov-StagHunt-v0", hunters=0)
    with pytest.raises(JaxactError, match="plants of Harvest must be at least 1, got 0"):
        envs_jax.make("Markov-Harvest-v0", plants=0)
    task = MixedRewards(dataclasses.replace(pomdp.task, hunters=3), others=1.0)
    with pytest.raises(JaxactError, match="takes 3 hunters, the environment's 2"):
        dataclasses.replace(pomdp, task=task)


def test_who_is_alone_sees_nobody_else():
    _, observation = envs_jax.make("Markov-Harvest-v0", agents=1).reset(jax.random.key(0))
    assert observation["map"][0, ..., :2].sum((0, 1)).tolist() == [1, 0]


@pytest.mark.parametrize("places", [25, 64, 65, 1000])
def test_choices_are_those_of_a_count_by_hand(places):
    generator = np.random.default_rng(0)
    allowed = generator.random((200, places)) < generator.random((200, 1))
    allowed[:2] = [[False], [True]]
    draws = generator.random(200, np.float32)
    draws[1] = np.nextafter(np.float32(1), np.float32(0))
    chosen = jax.vmap(grid.choose)(draws, allowed)
    for index, draw, row in zip(chosen.tolist(), draws, allowed, strict=True):
        free = np.flatnonzero(row)
        rank = min(int(draw * np.float32(len(free))), len(free) - 1)
        assert index == (free[rank] if len(free) else 0)
