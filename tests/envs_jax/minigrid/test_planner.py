"""The planner against a plain breadth-first search over (layer, x, y, heading)."""

from __future__ import annotations

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.minigrid import planner
from envs_jax.minigrid.guide import holds, make_guide
from envs_jax.minigrid.planner import ACT, ARRIVED, FORWARD, LEFT, RIGHT, Plan, Terrain

STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1)]
WIDTH, HEIGHT = 9, 7


def make_mazes(count: int, layers: int, seed: int) -> dict[str, np.ndarray]:
    """Random mazes: cell kinds 0 wall, 1 open, 2 slow, 3 gate (in all layers but the last)."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice(4, (count, layers, WIDTH, HEIGHT), p=[0.25, 0.6, 0.09, 0.06])
    kinds[:, -1][kinds[:, -1] == 3] = 1
    kinds[:, :, [0, -1]] = 0
    kinds[:, :, :, [0, -1]] = 0
    goals = rng.random((count, WIDTH, HEIGHT)) < 0.03
    position = np.stack([rng.integers(1, WIDTH - 1, count), rng.integers(1, HEIGHT - 1, count)], 1)
    kinds[np.arange(count), 0, position[:, 0], position[:, 1]] = 1
    return {
        "kinds": kinds,
        "goals": goals,
        "position": position.astype(np.int32),
        "direction": rng.integers(0, 4, count).astype(np.int32),
    }


def plan(kinds: jax.Array, goals: jax.Array, position: jax.Array, direction: jax.Array) -> Plan:
    layers = lambda kind: jax.vmap(planner.pack)(kinds == kind)  # noqa: E731
    terrain = Terrain(layers(1), layers(2), layers(3)[:-1])
    return planner.plan(terrain, planner.pack(goals), position, direction)


def successors(kinds: np.ndarray, pose: tuple[int, ...]) -> dict[int, tuple[tuple[int, ...], int]]:
    """Returns action -> (next pose, extra cost of entering); slow cells cost two actions."""
    layer, x, y, d = pose
    ahead = x + STEPS[d][0], y + STEPS[d][1]
    moves = {LEFT: ((layer, x, y, (d + 3) % 4), 1), RIGHT: ((layer, x, y, (d + 1) % 4), 1)}
    kind = kinds[layer][ahead]
    if kind == 1:
        moves[FORWARD] = ((layer, *ahead, d), 1)
    elif kind == 2:
        moves[ACT] = ((layer, *ahead, d), 2)
    elif kind == 3:
        moves[ACT] = ((layer + 1, x, y, d), 1)
    return moves


def search(kinds: np.ndarray, goals: np.ndarray, pose: tuple[int, ...]) -> int | None:
    """Returns the actions to the nearest pose that faces a goal, by breadth-first search."""
    queue, seen = deque([(0, pose)]), {}
    best = None
    while queue:
        cost, pose = queue.popleft()
        if seen.get(pose, cost + 1) <= cost:
            continue
        seen[pose] = cost
        _, x, y, d = pose
        if goals[x + STEPS[d][0], y + STEPS[d][1]] and kinds[pose[0]][x, y] in (1, 2):
            best = cost if best is None else min(best, cost)
        elif best is None or cost < best:
            for after, price in successors(kinds, pose).values():
                if kinds[after[0]][after[1], after[2]] in (1, 2):
                    queue.append((cost + price, after))
    return best


@pytest.mark.parametrize("layers", [1, 3])
def test_agrees_with_a_plain_search(layers: int) -> None:
    mazes = make_mazes(150, layers, seed=layers)
    with jax.numpy_dtype_promotion("strict"):
        plans = jax.tree.map(np.asarray, jax.jit(jax.vmap(plan))(*map(jnp.asarray, mazes.values())))
    reached = 0
    for i, (kinds, goals, position, direction) in enumerate(zip(*mazes.values(), strict=True)):
        pose = (0, *map(int, position), int(direction))
        expected = search(kinds, goals, pose)
        assert plans.reached[i] == (expected is not None)
        if expected is None:
            continue
        reached += 1
        assert plans.distance[i] == expected
        if expected == 0:
            assert plans.action[i] == ARRIVED
            continue
        after, price = successors(kinds, pose)[int(plans.action[i])]
        assert search(kinds, goals, after) == expected - price
    assert reached > 75


def test_one_lane_many_lanes_and_nested_lanes_agree() -> None:
    mazes = [jnp.asarray(array) for array in make_mazes(6, 1, seed=7).values()]
    flat = jax.jit(jax.vmap(plan))(*mazes)
    nested = jax.jit(jax.vmap(jax.vmap(plan)))(*(a.reshape(2, 3, *a.shape[1:]) for a in mazes))
    single = jax.jit(plan)(*(array[0] for array in mazes))
    for one, many, square in zip(*map(jax.tree.leaves, (single, flat, nested)), strict=True):
        assert one == many[0]
        np.testing.assert_array_equal(many, square.reshape(6))


def test_shared_arguments_need_no_lane_axis() -> None:
    kinds, goals, position, direction = map(jnp.asarray, make_mazes(5, 1, seed=3).values())
    over_poses = jax.jit(jax.vmap(plan, in_axes=(None, None, 0, 0)))
    shared = over_poses(kinds[0], goals[0], position, direction)
    for i, (p, d) in enumerate(zip(position.tolist(), direction.tolist(), strict=True)):
        expected = search(np.asarray(kinds[0]), np.asarray(goals[0]), (0, *p, d))
        if kinds[0, 0, p[0], p[1]] == 0:
            assert not shared.reached[i]
        else:
            assert expected == (int(shared.distance[i]) if shared.reached[i] else None)


def test_a_guide_has_the_plans_from_all_poses() -> None:
    kinds, goals, _, _ = map(jnp.asarray, make_mazes(8, 1, seed=5).values())
    poses = np.indices((WIDTH, HEIGHT, 4), np.int32).reshape(3, -1).T
    near = 4

    def both(kinds: jax.Array, goals: jax.Array) -> tuple[Plan, dict[str, jax.Array]]:
        cells = kinds == 1
        guide = make_guide(planner.pack(cells[0]), planner.pack(goals), near)

        def look(pose: jax.Array) -> tuple[Plan, dict[str, jax.Array]]:
            position, direction = pose[:2], pose[2]
            turns = {name: getattr(guide, name) for name in ("left", "right", "near")}
            said = {name: holds(poses, position, direction) for name, poses in turns.items()}
            said["reached"] = planner.contains(guide.reached, position)
            return plan(cells.astype(int), goals, position, direction), said

        return jax.vmap(look)(jnp.asarray(poses))

    plans, said = jax.tree.map(np.asarray, jax.jit(jax.vmap(both))(kinds, goals))
    reached = plans.reached
    assert 0 < reached.sum() < reached.size
    np.testing.assert_array_equal(said["reached"], reached)
    np.testing.assert_array_equal(said["left"], reached & (plans.action == LEFT))
    np.testing.assert_array_equal(said["right"], reached & (plans.action == RIGHT))
    np.testing.assert_array_equal(said["near"], reached & (plans.distance <= near))


def test_standing_goals_and_inactive_lanes() -> None:
    room = jnp.zeros((5, 4), bool).at[1:4, 1:3].set(True)
    terrain = Terrain(
        planner.pack(room)[None], jnp.zeros((1, 4), jnp.uint8), jnp.zeros((0, 4), jnp.uint8)
    )
    target = planner.pack(jnp.zeros((5, 4), bool).at[3, 2].set(True))
    start = jnp.array([1, 1], jnp.int32)
    plan_to = jax.jit(
        lambda pose, heading, on: planner.plan(
            terrain, target, pose, heading, stands=True, active=on
        )
    )
    found = plan_to(start, jnp.int32(0), True)
    assert (int(found.distance), int(found.action), bool(found.reached)) == (4, FORWARD, True)
    there = plan_to(jnp.array([3, 2], jnp.int32), jnp.int32(3), True)
    assert (int(there.distance), int(there.action)) == (0, ARRIVED)
    assert not plan_to(start, jnp.int32(0), False).reached


def test_boards_hold_what_was_packed() -> None:
    cells = jnp.asarray(np.random.default_rng(0).random((32, 25)) < 0.5)
    board = planner.pack(cells)
    assert board.dtype == jnp.uint32
    for x, y in [(0, 0), (31, 24), (5, 7), (30, 1)]:
        assert planner.contains(board, jnp.array([x, y], jnp.int32)) == cells[x, y]


def test_words_are_as_narrow_as_the_grid_allows() -> None:
    for width, word in [(8, jnp.uint8), (9, jnp.uint16), (16, jnp.uint16), (17, jnp.uint32)]:
        assert planner.pack(jnp.ones((width, 2), bool)).dtype == word


def test_grids_wider_than_a_word_are_refused() -> None:
    with pytest.raises(ValueError, match="33 cells wide"):
        planner.pack(jnp.zeros((33, 5), bool))
