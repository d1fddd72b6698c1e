"""Obstacles roam as randomly as the package's, and collisions cost what they cost there."""

from __future__ import annotations

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from minigrid_reference import python_env
from scipy.stats import chi2_contingency

import envs_jax
from envs_jax.minigrid import interop, tiles

LEFT, RIGHT, FORWARD = range(3)
BALL = tiles.tile(tiles.BALL, tiles.BLUE)


def crowded(cells: list[tuple[int, int]], agent: tuple[int, int]) -> object:
    """Returns the package's 6×6 world with its three obstacles in `cells`."""
    env = python_env("MiniGrid-Dynamic-Obstacles-6x6-v0")
    env.reset(seed=0)
    arrange(env, cells, agent)
    return env


def arrange(env: object, cells: list[tuple[int, int]], agent: tuple[int, int]) -> None:
    for ball in env.obstacles:
        env.grid.set(*ball.cur_pos, None)
    for ball, cell in zip(env.obstacles, cells, strict=True):
        env.put_obj(ball, *cell)
    env.agent_pos, env.agent_dir = agent, 0


@pytest.mark.parametrize("cells", [[(1, 1), (2, 1), (1, 2)], [(4, 3), (3, 3), (3, 4)]])
def test_obstacles_move_as_in_the_package(cells):
    # In the first scene the first ball is shut in by the others, the agent and walls.
    agent = (2, 2)
    env = crowded(cells, agent)
    pomdp, state = interop.from_minigrid(env)
    keys = jax.random.split(jax.random.key(0), 20_000)
    draw = jax.jit(jax.vmap(pomdp.environment.draw_moves, in_axes=(0, None)))
    ours = Counter(map(str, draw(keys, state.environment).tolist()))
    theirs = Counter()
    for _ in range(3000):
        arrange(env, cells, agent)
        env.step(LEFT)
        theirs[str([list(map(int, ball.cur_pos)) for ball in env.obstacles])] += 1
    values = [value for value in ours | theirs if ours[value] + theirs[value] >= 20]
    assert len(values) >= 6
    table = np.array([[ours[value] for value in values], [theirs[value] for value in values]])
    assert chi2_contingency(table).pvalue > 1e-5
    assert ours.total() - table[0].sum() < 0.02 * ours.total()


def test_what_was_ahead_before_the_obstacles_moved_is_run_into():
    env = crowded([(2, 1), (4, 1), (1, 4)], (1, 1))
    pomdp, state = interop.from_minigrid(env)
    take = jax.jit(jax.vmap(pomdp.step, in_axes=(0, None, None)))
    keys = jax.random.split(jax.random.key(1), 500)
    after, step = take(keys, state, jnp.int32(FORWARD))
    assert step.terminated.all()
    assert not step.success.any()
    assert (step.reward == -1).all()
    # The ball had made way, and the agent gone on.
    assert (after.environment.position == np.array([2, 1])).all()
    for action in (LEFT, RIGHT, 5):
        _, step = take(keys, state, jnp.int32(action))
        assert not step.terminated.any()


def test_obstacles_stay_apart_and_off_all_else():
    pomdp = envs_jax.make("MiniGrid-Dynamic-Obstacles-16x16-v0")

    def roam(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        state, _ = pomdp.reset(key)

        def once(state: object, key: jax.Array) -> tuple[object, tuple[jax.Array, ...]]:
            state, _ = pomdp.step(key, state, jax.random.randint(key, (), 0, 3))
            world = state.environment
            return state, (world.obstacles, world.position, jnp.sum(world.tiles == BALL))

        return jax.lax.scan(once, state, jax.random.split(key, 60))[1]

    keys = jax.random.split(jax.random.key(2), 50)
    obstacles, positions, balls = jax.device_get(jax.jit(jax.vmap(roam))(keys))
    assert (balls == 8).all()
    cells = np.concatenate([obstacles, positions[:, :, None]], axis=2).reshape(-1, 9, 2)
    assert all(len({tuple(cell) for cell in row}) == 9 for row in cells.tolist())
    assert cells.min() >= 1
    assert cells.max() <= 14
    moved = np.abs(np.diff(obstacles, axis=1)).max(axis=-1)
    assert moved.max() == 1
    assert moved.mean() > 0.99
