"""The lighthouse: walls and corners in view, rewards, and an expert who searches optimally."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.lighthouse import optimal_length
from envs_jax.lighthouse.environment import LighthouseState, corners
from envs_jax.lighthouse.sensors import CornerSensor
from envs_jax.lighthouse.tasks import SearchState
from jaxact import JaxactError
from jaxact.testing import check_pomdp

NAME = "Advisor-Lighthouse-v0"
DOWN, RIGHT, UP, LEFT, NONE = range(5)
EMPTY, GOAL, WRONG, WALL = range(4)
TOP_LEFT, TOP_RIGHT, BOTTOM_LEFT, BOTTOM_RIGHT = range(4)


def begin(pomdp, goal):
    state, _ = jax.jit(pomdp.reset)(jax.random.key(0))
    return replace(state, task=replace(state.task, goal=jnp.int32(goal)))


def play(pomdp, goal, actions):
    """All readings of the first sensor, the last state, and every step."""
    state, step = begin(pomdp, goal), jax.jit(pomdp.step)
    readings, steps = [next(iter(pomdp.observe(state).values()))], []
    for action in actions:
        state, taken = step(jax.random.key(0), state, jnp.int32(action))
        readings.append(next(iter(taken.observation.values())))
        steps.append(taken)
    return [reading.astype(int).tolist() for reading in readings], state, steps


def test_advisors_is_a_square_of_31_cells_a_side():
    pomdp = envs_jax.make(NAME)
    assert (pomdp.environment.dim, pomdp.environment.radius) == (2, 15)
    assert pomdp.task.expert_view_radius == 15
    assert pomdp.observation_space.spaces["design"].shape == (6400,)
    assert pomdp.environment.action_names == ("down", "right", "up", "left")
    assert pomdp.sensors["design"].view_radius == 1
    episode = pomdp.sampler.sample(jax.random.key(0), ())
    assert int(episode.horizon) == 1000
    assert episode.environment.position.tolist() == [0, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"dim": 1},
        {"dim": 1, "observation": "corners"},
        {"observation": "corners"},
        {"degree": 2},
    ],
)
def test_they_are_sound(options):
    check_pomdp(envs_jax.make(NAME, **options))


def test_corners_are_known_once_seen():
    """With a radius of 2 and a view of 1, from the centre to the top right and on to the left."""
    pomdp = envs_jax.make(NAME, radius=2, view_radius=1, observation="corners")
    readings, _, _ = play(pomdp, TOP_LEFT, [RIGHT, UP, LEFT, LEFT, LEFT])
    assert readings == [
        [EMPTY, EMPTY, EMPTY, EMPTY, NONE, NONE],
        [EMPTY, WALL, EMPTY, WALL, NONE, RIGHT],
        [WALL, WRONG, EMPTY, WALL, NONE, UP],
        [WALL, WRONG, EMPTY, EMPTY, NONE, LEFT],
        [GOAL, WRONG, WALL, EMPTY, NONE, LEFT],
        [GOAL, WRONG, WALL, EMPTY, LEFT, LEFT],
    ]
    # Along the border, the last push against it counts; away from it, the first that is touched.
    readings, _, _ = play(pomdp, TOP_LEFT, [UP, UP, UP, LEFT, LEFT, DOWN])
    assert [reading[4:] for reading in readings[2:]] == [
        [UP, UP],
        [UP, UP],
        [UP, LEFT],
        [LEFT, LEFT],
        [LEFT, DOWN],
    ]


def test_rewards():
    pomdp = envs_jax.make(NAME, radius=2, max_steps=4, observation="corners")
    _, _, steps = play(pomdp, BOTTOM_RIGHT, [DOWN, DOWN, RIGHT, RIGHT])
    np.testing.assert_allclose([s.reward for s in steps], [-0.01] * 3 + [0.99], rtol=1e-6)
    assert [bool(s.terminated) for s in steps] == [False] * 3 + [True]
    assert bool(steps[-1].success)
    # Too late: −0.01 / (1 − 0.99), in place of the step's own −0.01; nothing is bootstrapped.
    _, _, steps = play(pomdp, TOP_LEFT, [DOWN, DOWN, RIGHT, RIGHT])
    np.testing.assert_allclose([s.reward for s in steps], [-0.01] * 3 + [-1.0], rtol=1e-4)
    assert bool(steps[-1].terminated)
    assert not steps[-1].success


def searched(dim, radius, view_radius):
    """How many steps the expert takes to a goal in each corner."""
    pomdp = envs_jax.make(NAME, dim=dim, radius=radius, expert_view_radius=view_radius)
    environment, task, sampler = pomdp.environment, pomdp.task, pomdp.sampler
    episode = sampler.sample(jax.random.key(0), ())
    key = jax.random.key(0)

    def search(goal):
        def step(carry):
            state, progress, _ = carry
            action = task.expert(key, progress, state).action
            after = environment.step(key, state, action)
            progress, outcome = task.step(progress, state, action, after)
            return after, progress, outcome.terminated

        start = (episode.environment, replace(episode.task, goal=goal), jnp.bool_(False))
        _, progress, _ = jax.lax.while_loop(lambda carry: ~carry[2], step, start)
        return progress.steps

    return np.asarray(jax.jit(jax.vmap(search))(jnp.arange(2**dim, dtype=jnp.int32)))


@pytest.mark.parametrize(
    ("dim", "radius", "view_radius"),
    [
        (1, 5, 2),
        (2, 15, 1),
        (2, 4, 0),
        *(
            pytest.param(dim, radius, view, marks=pytest.mark.slow)
            for dim, radius in itertools.product((1, 2), (1, 2, 3, 15))
            for view in sorted({0, 1, 2, 3, 5, radius - 1, radius, radius + 2})
        ),
    ],
)
def test_the_expert_searches_optimally(dim, radius, view_radius):
    """Each corner is as likely to be the goal, so that this is the mean length exactly."""
    lengths = searched(dim, radius, view_radius)
    assert lengths.mean() == optimal_length(dim, radius, view_radius)


def test_optimal_lengths():
    assert optimal_length(2, 15, 1) == 0.25 * (8 * 1 + 10 * 2 * 14) == 72
    assert optimal_length(2, 15, 15) == 30
    assert optimal_length(1, 15, 3) == 27


def test_no_search_of_a_small_square_is_shorter():
    """The best order of looking into the corners, over all walks of a radius of 2, view 1."""
    radius, view = 2, 1
    places = radius * corners(2)
    moves = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])

    def solve(position, seen, depth, memo):
        """The least sum of lengths over the goals not seen yet, within `depth` steps."""
        near = np.abs(places - position).max(axis=1) <= view
        now = seen | frozenset(np.flatnonzero(near).tolist())
        total = sum(int(np.abs(places[corner] - position).sum()) for corner in now - seen)
        left = 4 - len(now)
        if left == 0:
            return total
        if depth == 0:
            return np.inf
        key = (tuple(position), now, depth)
        if key not in memo:
            memo[key] = min(
                left + solve(np.clip(position + move, -radius, radius), now, depth - 1, memo)
                for move in moves
            )
        return total + memo[key]

    best = solve(np.zeros(2, int), frozenset(), 9, {}) / 4
    assert best == optimal_length(2, radius, view)


def test_the_design_is_a_table_or_has_a_degree():
    table = envs_jax.make(NAME, dim=1, radius=3)
    corner = envs_jax.make(NAME, dim=1, radius=3, observation="corners")
    lines = envs_jax.make(NAME, dim=1, radius=3, degree=1).sensors["design"]
    pairs = envs_jax.make(NAME, dim=1, radius=3, degree=2).sensors["design"]
    full = envs_jax.make(NAME, dim=1, radius=3, degree=4).sensors["design"]
    assert table.sensors["design"].space.shape == (81,)
    shapes = [sensor.space.shape for sensor in (lines, pairs, full)]
    assert shapes == [(9,), (1 + 4 * 2 + 6 * 4,), (81,)]
    walk = [0, 0, 1, 1, 1, 1]
    readings, _, _ = play(corner, 1, walk)
    rows, state, _ = play(table, 1, walk)
    for reading, row in zip(readings, rows, strict=True):
        place = np.ravel_multi_index(reading, (3, 3, 3, 3))
        assert row == np.eye(81, dtype=int)[place].tolist()
    row = lines.observe(state.environment, state.task).tolist()
    coded = [np.eye(3, dtype=int)[value][1:] for value in readings[-1]]
    assert row == [1, *np.concatenate(coded).tolist()]
    row = pairs.observe(state.environment, state.task).tolist()
    products = [np.outer(one, other).ravel() for one, other in itertools.combinations(coded, 2)]
    assert row == [1, *np.concatenate(coded + products).tolist()]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dim": 3}, "dim must be 1 or 2, got 3"),
        ({"radius": 0}, "radius and max_steps must be positive, got 0 and 1000"),
        ({"view_radius": -1}, "views must not be negative, got -1 and 15"),
        ({"degree": 0}, "degree must be at least 1, got 0"),
        ({"observation": "corner"}, "unknown observation 'corner'"),
    ],
)
def test_bad_options_are_answered_with_a_sentence(options, message):
    with pytest.raises(JaxactError, match=message):
        envs_jax.make(NAME, **options)


@pytest.mark.parametrize("dim", [1, 2])
def test_pictures_show_agent_goal_and_view(dim):
    sensor = CornerSensor(dim, 2, 1)
    start = LighthouseState(
        jnp.zeros(dim, jnp.int32), jnp.full(2**dim, 2, jnp.int32), jnp.int32(2 * dim)
    )
    task = SearchState(jnp.int32(2**dim - 1), jnp.int32(0), jnp.int32(9))
    frame = np.asarray(sensor.picture(start, task))[::32, ::32]
    assert frame.shape == ((1, 5, 3) if dim == 1 else (5, 5, 3))
    red, green = frame[..., 0] == 255, frame[..., 1] == 255
    assert np.argwhere(red).tolist() == [[0, 2] if dim == 1 else [2, 2]]
    assert np.argwhere(green).tolist() == [[0, 4] if dim == 1 else [4, 4]]
    assert np.sum(frame[..., 2] == 90) == 3**dim - 1
