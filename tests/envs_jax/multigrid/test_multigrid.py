"""gym-multigrid's games against their rules in plain Python, and against the original if it is
installed, from thousands of random states.
"""

import dataclasses
import functools
import importlib.util

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.minigrid import tiles
from envs_jax.multigrid import MultiGridState
from envs_jax.multigrid.environment import OBJECT_GOAL
from jaxact import JaxactError
from jaxact.pomdp import Episode
from jaxact.testing import check_pomdp
from tests.envs_jax.multigrid import rules
from tests.envs_jax.multigrid.rules import Agent, Game

SOCCER, COLLECT = "MultiGrid-Soccer4HEnv10x15N2-v0", "MultiGrid-Collect4HEnv10x10N2-v0"
LANES, STEPS = 48, 32
# Less turning, more of what changes hands than by chance.
CHANCES = np.array([1, 3, 3, 8, 8, 8, 1, 1]) / 33
# All of soccer's goals pay the same.
TWO = (2.0,) * 6
WORTH = (1.0, 2.0, 0.5, 4.0, 3.0, 5.0)
VARIANTS = {
    "soccer": (SOCCER, {"goal_reward": 2.0}),
    "soccer at once": (SOCCER, {"goal_reward": 2.0, "moves": "at_once"}),
    "soccer of three teams": (
        SOCCER,
        {
            "goal_reward": 2.0,
            "agents_index": (0, 1, 1, 2, 5),
            "zero_sum": False,
            "view_size": 3,
            "width": 8,
            "height": 7,
            "goal_pst": ((1, 5),),
            "goal_index": (1,),
        },
    ),
    "collect": (COLLECT, {"agents_index": (1, 2, 3, 0)}),
    "collect at once": (COLLECT, {"moves": "at_once", "credit": "color"}),
    "collect by number": (COLLECT, {"credit": "number", "zero_sum": False}),
    "collect by number for all": (COLLECT, {"credit": "number", "agents_index": (0, 1, 2)}),
}


def pomdp_of(name):
    """The world of a variant, in which balls are worth different amounts."""
    world, options = VARIANTS[name]
    pomdp = envs_jax.make(world, **options)
    if world == COLLECT:
        pomdp = dataclasses.replace(pomdp, task=dataclasses.replace(pomdp.task, rewards=WORTH))
    return pomdp


def scatter(generator, world):
    """A crowded state: walls, balls and goals of all colours, some agents with balls."""
    field = np.full((world.width, world.height), tiles.WALL_TILE, np.uint8)
    kinds = np.array([tiles.EMPTY, tiles.WALL, tiles.BALL, OBJECT_GOAL])
    inside = (world.width - 2, world.height - 2)
    drawn = generator.choice(kinds, inside, p=[0.65, 0.1, 0.15, 0.1])
    # Half of what has a colour has the first: that is anybody's.
    color = generator.integers(0, 6, inside) * generator.integers(0, 2, inside)
    color = np.where(drawn == tiles.EMPTY, 0, np.where(drawn == tiles.WALL, tiles.GREY, color))
    if world.pickup == "collects":
        drawn, color = (
            np.where(drawn == OBJECT_GOAL, new, old) for new, old in ((1, drawn), (0, color))
        )
    field[1:-1, 1:-1] = drawn | color << tiles.COLOR_SHIFT
    free = np.argwhere(field == tiles.EMPTY_TILE)
    # Close to each other, so that they meet.
    middle = free[generator.integers(len(free))]
    free = free[np.argsort(np.abs(free - middle).sum(-1) + generator.random(len(free)))]
    held = tiles.BALL | generator.integers(0, 3, world.agents) << tiles.COLOR_SHIFT
    holds = (generator.random(world.agents) < 0.4) & (world.pickup == "carries")
    return MultiGridState(
        tiles=field,
        positions=free[: world.agents].astype(np.int32),
        directions=generator.integers(0, 4, world.agents).astype(np.int32),
        carrying=np.where(holds, held, 0).astype(np.uint8),
        scored=np.zeros(world.agents, np.uint8),
    )


def game_of(state, world):
    """A state as the rules have it."""
    game = Game(set(), {}, {}, [], world.pickup == "carries")
    for x, y in np.argwhere(state.tiles != tiles.EMPTY_TILE).tolist():
        kind, color = state.tiles[x, y] & 15, int(state.tiles[x, y] >> 4)
        if kind == tiles.WALL:
            game.walls.add((x, y))
        else:
            {tiles.BALL: game.balls, OBJECT_GOAL: game.goals}[kind][x, y] = color
    for a, index in enumerate(world.agents_index):
        held = int(state.carrying[a])
        assert held == 0 or held & 15 == tiles.BALL
        cell = tuple(state.positions[a].tolist())
        game.agents.append(
            Agent(index, cell, int(state.directions[a]), held >> 4 if held else None)
        )
    return game


@functools.cache
def played(name):
    """Random actions from scattered states: orders, actions, states after each step, results."""
    pomdp = pomdp_of(name)
    world, generator = pomdp.environment, np.random.default_rng(0)
    starts = [scatter(generator, world) for _ in range(LANES)]
    actions = generator.choice(8, (STEPS, LANES, world.agents), p=CHANCES).astype(np.int32)
    start = jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)

    def begin(state):
        return pomdp.begin(Episode(state, pomdp.task.start, jnp.int32(100)))

    def step(state, given):
        key, action = given
        keys = jax.random.split(key, LANES)
        state, result = jax.vmap(pomdp.step)(keys, state, action)
        return state, (jax.vmap(world.order)(keys), state, result)

    keys = jax.random.split(jax.random.key(1), STEPS)
    play = jax.jit(lambda state: jax.lax.scan(step, jax.vmap(begin)(state), (keys, actions))[1])
    orders, after, results = jax.tree.map(np.asarray, play(start))
    return pomdp, starts, orders, actions, after.environment, results


def lane_of(tree, t, lane):
    return jax.tree.map(lambda leaf: leaf[t, lane], tree)


@pytest.mark.parametrize("name", VARIANTS)
def test_every_step_is_as_the_rules_say(name):
    pomdp, starts, orders, actions, after, results = played(name)
    world, task, size = pomdp.environment, pomdp.task, pomdp.sensors["image"].view_size
    worth = [float(reward) for reward in task.rewards]
    assert worth == list(WORTH if world.pickup == "collects" else TWO)
    total = orderings = 0
    for lane in range(LANES):
        game = game_of(starts[lane], world)
        scored = 0
        for t in range(STEPS):
            order = orders[t, lane].tolist()
            orderings |= 1 << order[0]
            game.step(actions[t, lane].tolist(), order, world.moves == "at_once")
            found = dataclasses.replace(game_of(lane_of(after, t, lane), world), scored=game.scored)
            assert found == game, (name, lane, t)
            result = lane_of(results, t, lane)
            rewards = game.rewards(task.credit, worth, task.zero_sum)
            np.testing.assert_allclose(result.reward, rewards, err_msg=f"{name} {lane} {t}")
            scored += len(game.scored)
            assert result.metrics["scored"] == scored
            assert result.success == (scored >= task.balls)
            assert not result.terminated
            if (lane + t) % 8 == 0:
                views = [game.view(a, size, world.width, world.height) for a in range(world.agents)]
                np.testing.assert_array_equal(result.observation["image"], views)
        total += scored
    assert total > 20
    assert orderings == 2**world.agents - 1


def test_hands_change_in_soccer_as_often_as_it_takes_to_test_it():
    for name in ("soccer", "soccer at once"):
        pomdp, starts, _, actions, after, _ = played(name)
        before = np.concatenate([np.stack([s.carrying for s in starts])[None], after.carrying[:-1]])
        took = (before == 0) & (after.carrying != 0)
        lost = (before != 0) & (after.carrying == 0)
        assert (took & (actions != rules.PICKUP)).sum() > 20  # Passed to.
        assert (lost & (actions != rules.DROP)).sum() > 20  # Robbed.
        assert (took & (actions == rules.PICKUP)).sum() > 50
        assert (lost & (actions == rules.DROP)).sum() > 50
        # All of this leaves as many balls as there were, but for those in goals.
        held = (after.carrying[-1] != 0).sum(-1) + (after.tiles[-1] & 15 == tiles.BALL).sum((1, 2))
        first = np.stack(
            [(s.carrying != 0).sum() + (s.tiles & 15 == tiles.BALL).sum() for s in starts]
        )
        np.testing.assert_array_equal(held + (after.scored != 0).sum((0, 2)), first)
        assert pomdp.environment.agents == 4


@pytest.mark.parametrize("name", [n for n in VARIANTS if "at once" not in n])
def test_every_step_is_as_the_original_has_it(name):
    if importlib.util.find_spec("gym_multigrid") is None:
        pytest.skip("gym_multigrid is not installed (github.com/ArnaudFickinger/gym-multigrid)")
    from tests.envs_jax.multigrid.original import Original

    pomdp, starts, orders, actions, after, results = played(name)
    world, task, size = pomdp.environment, pomdp.task, pomdp.sensors["image"].view_size
    worth = [float(reward) for reward in task.rewards]
    for lane in range(LANES):
        begin = game_of(starts[lane], world)
        original = Original(begin, world.width, world.height, size, task.zero_sum, worth)
        for t in range(STEPS):
            views, rewards, done = original.step(
                actions[t, lane].tolist(), orders[t, lane].tolist()
            )
            assert original.game() == game_of(lane_of(after, t, lane), world), (name, lane, t)
            result = lane_of(results, t, lane)
            if task.credit != "team":  # Which the original has not.
                np.testing.assert_allclose(result.reward, rewards)
            np.testing.assert_array_equal(result.observation["image"], views)
            assert not done
