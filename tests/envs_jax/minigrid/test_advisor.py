"""ADVISOR's grid worlds: crossings, crossings in the dark, and experts that are of no use."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import envs_jax
from envs_jax.minigrid import tiles
from envs_jax.minigrid.corruption import corrupt_expert
from envs_jax.minigrid.environment import FORWARD, LEFT, RIGHT
from envs_jax.minigrid.state import PADDING
from jaxact import JaxactError
from jaxact.samplers import MixtureSampler, PrioritizedLevelReplay
from jaxact.testing import check_pomdp

ASK = 3


@pytest.mark.parametrize(
    ("name", "size", "rivers", "river"),
    [
        ("LavaCrossingS15N7", 15, 7, tiles.LAVA),
        ("LavaCrossingS25N10", 25, 10, tiles.LAVA),
        ("WallCrossingS25N10", 25, 10, tiles.WALL),
        ("AskForHelpLavaCrossingSmall", 9, 4, tiles.LAVA),
    ],
)
def test_rivers_can_be_crossed(name, size, rivers, river):
    pomdp = envs_jax.make(f"Advisor-{name}-v0")
    keys = jax.random.split(jax.random.key(0), 30)
    episodes = jax.jit(jax.vmap(pomdp.sampler.sample, (0, None)))(keys, ())
    assert set(np.asarray(episodes.horizon).tolist()) == {4 * size**2}
    inside = slice(PADDING + 1, PADDING + size - 1)
    planes = np.asarray(episodes.environment.tiles)[:, inside, inside] & tiles.TYPE_MASK
    for kinds in planes:
        wet = kinds == river
        # A river is a line of it with one opening.
        assert sum((wet.sum(axis) == size - 3).sum() for axis in (0, 1)) == rivers
        assert kinds[-1, -1] == tiles.GOAL
        land, _ = ndimage.label(~wet)
        assert land[0, 0] == land[-1, -1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "actions"),
    [
        ("LavaCrossingS15N7", ("left", "right", "forward")),
        ("AskForHelpLavaCrossingSmall", ("left", "right", "forward", "toggle")),
        ("LavaCrossingCorruptExpertS15N7", ("left", "right", "forward")),
    ],
)
def test_they_are_sound(name, actions):
    pomdp = envs_jax.make(f"Advisor-{name}-v0")
    assert pomdp.environment.action_names == actions
    assert pomdp.action_space.n == len(actions)
    check_pomdp(pomdp, lanes=2, steps=4)


@pytest.mark.parametrize(
    ("name", "size", "rivers", "walls", "stays"),
    [
        ("SimpleCrossing", 15, 7, True, False),
        ("SimpleCrossingOnce", 25, 10, True, True),
        ("LavaCrossingOnce", 15, 7, False, True),
        ("LavaCrossingSmall", 9, 4, False, False),
    ],
)
def test_those_in_the_dark_are_advisors(name, size, rivers, walls, stays):
    pomdp = envs_jax.make(f"Advisor-AskForHelp{name}-v0")
    crossing = pomdp.sampler.sampler
    assert (crossing.size, crossing.num_crossings, crossing.walls) == (size, rivers, walls)
    assert pomdp.environment.toggle_is_permanent == stays


def dark_room(**task):
    """A crossing in the dark, of lava two cells ahead of the agent's first; where it begins."""
    pomdp = envs_jax.make("Advisor-AskForHelpLavaCrossingSmall-v0", **task)
    state, observation = jax.jit(pomdp.reset)(jax.random.key(0))
    plane = jnp.full_like(state.environment.tiles, tiles.WALL_TILE)
    plane = plane.at[PADDING + 1 : PADDING + 8, PADDING + 1 : PADDING + 8].set(tiles.EMPTY_TILE)
    plane = plane.at[PADDING + 3, PADDING + 1].set(tiles.LAVA_TILE)
    return pomdp, replace(state, environment=replace(state.environment, tiles=plane)), observation


@functools.cache
def compiled_step(pomdp):
    return jax.jit(pomdp.step)


def play(pomdp, state, actions):
    step, steps = compiled_step(pomdp), []
    for action in actions:
        state, taken = step(jax.random.key(0), state, jnp.int32(action))
        steps.append(taken)
    return state, steps


@pytest.mark.parametrize("stays", [False, True])
def test_the_image_is_dark_until_asked_for(stays):
    pomdp, state, first = dark_room()
    pomdp = replace(pomdp, environment=replace(pomdp.environment, toggle_is_permanent=stays))
    assert not first["image"].any()
    _, steps = play(pomdp, state, [LEFT, ASK, ASK, LEFT, ASK])
    shown = [bool(step.observation["image"].any()) for step in steps]
    assert shown == [False, True, True, stays, True]
    lit = envs_jax.make("Advisor-LavaCrossingS15N7-v0").sensors["image"]
    lit = replace(lit, width=9, height=9)
    state, steps = play(pomdp, state, [ASK])
    seen = lit.observe(state.environment, state.task)
    np.testing.assert_array_equal(steps[-1].observation["image"], seen)
    # Asking neither moves the agent nor changes the grid.
    assert state.environment.position.tolist() == [1, 1]


def test_rewards_and_metrics_of_the_search():
    pomdp, state, _ = dark_room(exploration_reward=0.25, death_penalty=-1.5)
    # Into a new cell, help, back to where it began, and forward twice: the last time into lava.
    _, steps = play(pomdp, state, [FORWARD, ASK, LEFT, LEFT, FORWARD, LEFT, LEFT, FORWARD, FORWARD])
    assert [float(step.reward) for step in steps] == [0.25, *[0.0] * 7, 0.25 - 1.5]
    assert [bool(step.terminated) for step in steps] == [False] * 8 + [True]
    assert not steps[-1].success
    counts = [float(step.metrics["explored_count"]) for step in steps]
    assert counts == [2.0] * 8 + [3.0]
    distances = [float(step.metrics["final_distance"]) for step in steps]
    assert distances == [11.0] * 8 + [10.0]  # the nearest so far: it does not grow on the way back
    shares = [float(step.metrics["toggle_percent"]) for step in steps]
    np.testing.assert_allclose(shares, [0, *(1 / n for n in range(2, 10))], rtol=1e-6)
    # Death with the very last step is not punished.
    late = replace(state, task=replace(state.task, steps=state.task.max_steps - 2))
    _, steps = play(pomdp, late, [FORWARD, FORWARD])
    assert float(steps[-1].reward) == 0.25
    assert bool(steps[-1].terminated)


def test_corrupt_experts_are_sound_until_near_the_goal_and_never_again():
    pomdp = envs_jax.make("Advisor-LavaCrossingCorruptExpertS15N7-v0")
    assert pomdp.task.within == 9  # ADVISOR's 10, which count one action more
    assert envs_jax.make("Advisor-WallCrossingCorruptExpertS25N10-v0").task.within == 14
    begun, _ = jax.jit(pomdp.reset)(jax.random.key(3))
    keys = jax.random.split(jax.random.key(4), 300)
    ask = jax.jit(jax.vmap(lambda key, state: pomdp.expert(key, state).action, (0, None)))
    sound = envs_jax.make("Advisor-LavaCrossingS15N7-v0").task
    plan = jax.jit(lambda world: sound.expert(keys[0], None, world).action)
    state, way, said = begun, [], []
    for _ in range(60):
        said.append(np.asarray(ask(keys, state)))
        way.append(int(plan(state.environment)))
        state, (step,) = play(pomdp, state, way[-1:])
        if step.terminated:
            break
    assert step.success
    for left, right, advice in zip(range(len(way), 0, -1), way, said, strict=True):
        shares = np.bincount(advice, minlength=3) / len(advice)
        expected = np.full(3, 1 / 3) if left <= 9 else np.eye(3)[right]
        np.testing.assert_allclose(shares, expected, atol=0.12)
    # Away again from where nine actions were left: what it has come to stays.
    away = RIGHT if way[-9] == LEFT else LEFT
    state, _ = play(pomdp, begun, [*way[:-9], away])
    assert state.task.was_near
    assert len(set(np.asarray(ask(keys, state)).tolist())) == 3


def test_what_cannot_be_corrupted_is_refused():
    crossing = envs_jax.make("MiniGrid-LavaGapS5-v0")
    assert corrupt_expert(crossing, 3).task.num_actions == 7
    assert envs_jax.make("Advisor-LavaCrossingS15N7-v0", corrupt_within=2).task.within == 2
    with pytest.raises(JaxactError, match="within must not be negative, got -1"):
        corrupt_expert(crossing, -1)
    with pytest.raises(JaxactError, match="only a GoalTask's expert can be corrupted, not that of"):
        corrupt_expert(envs_jax.make("BabyAI-GoToLocal-v0"), 3)
    for name in ("DoorKey-8x8", "LockedRoom", "MultiRoom-N2-S4"):
        with pytest.raises(JaxactError, match="have doors, but a corrupt expert plans"):
            corrupt_expert(envs_jax.make(f"MiniGrid-{name}-v0"), 3)
    learning = replace(crossing, sampler=PrioritizedLevelReplay(crossing.sampler))
    with pytest.raises(JaxactError, match="PrioritizedLevelReplay learns"):
        corrupt_expert(learning, 3)


def test_a_corrupt_expert_keeps_the_kinds_of_episodes():
    crossing = envs_jax.make("MiniGrid-LavaGapS5-v0")
    mixture = MixtureSampler({"one": crossing.sampler, "other": crossing.sampler})
    sampler = corrupt_expert(replace(crossing, sampler=mixture), 3).sampler

    def kinds(key):
        return sampler.kinds(sampler.sample(key, sampler.init(key)).origin)

    assert set(jax.eval_shape(kinds, jax.random.key(0))) == {"one", "other"}
    assert sampler.held_out == replace(sampler, sampler=mixture.held_out)
