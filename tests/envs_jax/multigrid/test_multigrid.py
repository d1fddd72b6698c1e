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
LANES, STEPS = 64, 24
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
    drawn = generator.choice(kinds, inside, p=[0.55, 0.1, 0.15, 0.2])
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
    color = generator.integers(0, 3, world.agents) * generator.integers(0, 2, world.agents)
    held = tiles.BALL | color << tiles.COLOR_SHIFT
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


@pytest.mark.parametrize("name", [SOCCER, pytest.param(COLLECT, marks=pytest.mark.slow)])
def test_the_worlds_are_sound(name):
    check_pomdp(envs_jax.make(name))


def test_episodes_begin_anywhere_with_what_they_should_have():
    lanes = 2000
    pomdp = envs_jax.make(SOCCER, num_balls=(1, 2), balls_index=(0, 2), width=7, height=6,
                          goal_pst=((1, 3), (5, 3)))  # fmt: skip
    begin = jax.jit(jax.vmap(lambda key: pomdp.reset(key)[0]))
    state = jax.tree.map(np.asarray, begin(jax.random.split(jax.random.key(0), lanes)))
    world, games = state.environment, []
    for lane in range(lanes):
        one = jax.tree.map(lambda leaf, lane=lane: leaf[lane], world)
        games.append(game_of(one, pomdp.environment))
    assert all(game.goals == {(1, 3): 1, (5, 3): 2} for game in games)
    assert all(sorted(game.balls.values()) == [0, 2, 2] for game in games)
    assert all(len({agent.cell for agent in game.agents} - set(game.balls)) == 4 for game in games)
    assert not world.carrying.any()
    assert (state.horizon == 10_000).all()
    # 18 cells are free for 3 balls and 4 agents: each has everything as often, and all directions.
    for cells in (
        np.argwhere(world.tiles & 15 == tiles.BALL)[:, 1:],
        world.positions.reshape(-1, 2),
    ):
        found, counts = np.unique(cells, axis=0, return_counts=True)
        assert len(found) == 18
        expected = len(cells) / 18
        assert abs(counts - expected).max() < 5 * expected**0.5
    assert abs(np.bincount(world.directions.reshape(-1)) / (4 * lanes) - 0.25).max() < 0.03


def test_the_full_grid_is_the_same_but_for_who_one_is():
    name = "soccer"
    pomdp, starts, *_ = played(name)
    world = pomdp.environment
    full = envs_jax.make(SOCCER, observation="full").sensors["image"]
    for start in starts[:8]:
        game = game_of(start, world)
        image = np.asarray(full.observe(jax.tree.map(jnp.asarray, start), None))
        for x in range(world.width):
            for y in range(world.height):
                for a, agent in enumerate(game.agents):
                    is_wall = (x, y) in game.walls
                    expected = (2, 5, 0, 0, 0, 0) if is_wall else game.encoded((x, y), agent)
                    assert image[a, x, y].tolist() == list(expected)


def test_an_episode_may_end_with_the_last_ball():
    pomdp = envs_jax.make(SOCCER, ends=True)
    state, _ = pomdp.reset(jax.random.key(0))
    world = dataclasses.replace(
        state.environment,
        tiles=jnp.where(state.environment.tiles == tiles.BALL, 1, state.environment.tiles),
        positions=jnp.int32([[2, 5], [8, 8], [9, 8], [10, 8]]),
        directions=jnp.int32([2, 0, 0, 0]),
        carrying=jnp.uint8([tiles.BALL, 0, 0, 0]),
    )
    state = dataclasses.replace(state, environment=world)
    step = jax.jit(pomdp.step)
    state, result = step(jax.random.key(1), state, jnp.int32([0, 0, 0, 0]))
    assert not result.terminated
    picture = np.asarray(jax.jit(pomdp.pictures)(state)["image"])
    assert picture.shape == (120, 180, 3)
    assert (picture[5 * 12 + 6, 2 * 12 + 6] == [255, 0, 0]).all()  # The ball on the agent.
    assert (picture[5 * 12 + 6, 1 * 12 + 6] == [0, 255, 0]).all()  # The green goal.
    state, result = step(jax.random.key(1), state, jnp.int32([rules.DROP, 0, 0, 0]))
    assert result.terminated
    assert result.success
    np.testing.assert_allclose(result.reward, [1, 1, -1, -1])
    assert result.metrics["scored_green"] == 1
    assert result.metrics["scored_blue"] == 0


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (SOCCER, {"moves": "in_turns"}, "unknown moves 'in_turns'; the nearest is 'in_turn'"),
        (SOCCER, {"agents_index": (1, 6)}, "agents_index must be from 0 to 5; got 6"),
        (SOCCER, {"agents_index": ()}, "there must be 1 to 16 agents, not 0"),
        (SOCCER, {"goal_pst": ((0, 5), (13, 5))}, r"inside the walls of 15×10; got \(0, 5\)"),
        (SOCCER, {"goal_index": (1,)}, "as long as each other; they are of 2 and 1"),
        (SOCCER, {"view_size": 4}, "view_size must be odd"),
        (SOCCER, {"observation": "rgb"}, "unknown observation 'rgb'"),
        (COLLECT, {"num_balls": (62,)}, "has room for 64 balls and agents, and there would be 65"),
        (COLLECT, {"credit": "colour"}, "unknown credit 'colour'; the nearest is 'color'"),
        (COLLECT, {"balls_reward": (1.0, 2.0)}, "one reward for each of balls_index"),
        (COLLECT, {"width": 2}, "at least 3×3 cells, not 2×10"),
    ],
)
def test_what_cannot_be_is_refused(name, options, message):
    with pytest.raises(JaxactError, match=message):
        envs_jax.make(name, **options)
