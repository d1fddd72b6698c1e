"""PointNav: rewards, success and metrics of a walk down an empty room."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_houses import BODY, ROOMS, walls

from envs_jax.houses.categories import index
from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import GoalField, build_roadmap, goal_field
from envs_jax.houses.journey import Journey
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.scene import make_scene

ACTIONS = ("move_ahead", "rotate_left", "rotate_right", "end")
AHEAD, LEFT, RIGHT, END = range(4)
HOUSE = House(BODY, ACTIONS)
TASK = PointNav(HOUSE)


@pytest.fixture(scope="module")
def play():
    """Plays actions from (1, 1) towards a goal; returns what each step says."""
    scene = make_scene(walls(), [index("Wall")] * 7, ROOMS)

    @jax.jit
    def start(goal):
        state = HOUSE.start(scene, jnp.array([1, 1], jnp.float32))
        roadmap = build_roadmap(scene, BODY, 32)
        field = goal_field(roadmap, obstacles(scene.boxes, BODY), BODY.radius, goal[None])
        return state, TASK.start(field, state, goal)

    @jax.jit
    def step(state, task_state, action):
        after = HOUSE.step(jax.random.key(0), state, action)
        task_state, outcome = TASK.step(task_state, state, action, after)
        return after, task_state, outcome

    def run(goal, actions):
        state, task_state = start(jnp.asarray(goal, jnp.float32))
        outcomes = []
        for action in actions:
            state, task_state, outcome = step(state, task_state, jnp.int32(action))
            outcomes.append(outcome)
        return task_state, outcomes

    return run


def test_the_chart_shows_the_way_taken_and_the_shortest():
    scene = make_scene(walls(), [index("Wall")] * 7, ROOMS)
    roadmap = build_roadmap(scene, BODY, 32)

    @jax.jit
    def draw(goal, trail):
        state = HOUSE.start(scene, trail[0])
        field = goal_field(roadmap, obstacles(scene.boxes, BODY), BODY.radius, goal[None])
        task_state = TASK.start(field, state, goal)
        return HOUSE.chart(state, task_state, trail), HOUSE.chart(state, None, trail)

    def share(picture, colour):
        return np.mean(np.all(picture == np.uint8(colour), axis=-1))

    trail = jnp.float32([[1, 1], [2, 1], [2, 2], [jnp.nan, jnp.nan]])
    near, bare = draw(jnp.float32([1, 2.1]), trail)
    far, _ = draw(jnp.float32([1, 3.2]), trail)
    blue, orange, green = (38, 89, 230), (242, 166, 26), (26, 166, 51)
    assert share(bare, blue) == share(near, blue) > 0
    assert share(bare, orange) == share(bare, green) == 0
    assert 0 < share(near, orange) < share(far, orange)
    assert share(near, green) > 0


def test_a_walk_straight_ahead_earns_what_it_covers(play):
    task_state, outcomes = play((1, 2.1), [AHEAD, AHEAD, AHEAD, AHEAD, END])
    assert float(task_state.journey.start_distance) == pytest.approx(1.1, abs=1e-5)
    first = outcomes[0]
    assert float(first.reward["step"]) == pytest.approx(-0.01)
    assert float(first.reward["shaping"]) == pytest.approx(0.25, abs=1e-5)
    assert not bool(first.terminated)
    last = outcomes[-1]
    assert bool(last.terminated)
    assert bool(last.success["goal"])
    assert float(last.reward["success"]) == 10
    assert float(last.reward["shaping"]) == 0
    # It stopped 10 cm short, which counts as all of the way.
    assert float(last.metrics["spl"]) == 1
    assert float(last.metrics["soft_spl"]) == pytest.approx(1 - 0.1 / 1.1, abs=1e-4)
    assert float(last.metrics["distance_to_goal"]) == pytest.approx(0.1, abs=1e-5)
    assert float(last.metrics["path_length"]) == pytest.approx(1, abs=1e-5)


def test_ending_elsewhere_fails(play):
    _, outcomes = play((1, 2.1), [AHEAD, END])
    assert bool(outcomes[-1].terminated)
    assert not bool(outcomes[-1].success["goal"])
    assert float(outcomes[-1].reward["success"]) == 0
    assert float(outcomes[-1].metrics["spl"]) == 0
    assert float(outcomes[-1].metrics["soft_spl"]) == pytest.approx(0.25 / 1.1, abs=1e-4)


def test_who_starts_at_the_goal_needs_only_to_say_so(play):
    _, (at_once,) = play((1, 1), [END])
    assert float(at_once.metrics["spl"]) == 1
    assert float(at_once.metrics["soft_spl"]) == 1
    _, outcomes = play((1, 1), [AHEAD, RIGHT, RIGHT, RIGHT, RIGHT, RIGHT, RIGHT, AHEAD, END])
    assert bool(outcomes[-1].success["goal"])
    assert float(outcomes[-1].metrics["spl"]) == 0


def test_an_immediate_end_near_the_goal_is_a_success_without_a_step(play):
    _, (outcome,) = play((1, 1.15), [END])
    assert bool(outcome.success["goal"])
    assert float(outcome.metrics["spl"]) == 1
    assert float(outcome.metrics["path_length"]) == 0


def test_without_a_way_there_is_no_success(play):
    # Beyond the outer wall.
    task_state, outcomes = play((1, -1), [AHEAD, END])
    assert float(task_state.journey.start_distance) == float("inf")
    assert float(outcomes[-1].metrics["spl"]) == 0
    assert float(outcomes[-1].metrics["soft_spl"]) == 0
    assert not bool(outcomes[-1].success["goal"])
    assert jnp.isfinite(outcomes[0].reward["shaping"])


def test_a_strict_radius_leaves_out_its_rim():
    none = GoalField(jnp.zeros((1, 2), jnp.float32), jnp.zeros(1, jnp.float32))
    journey = Journey(none, jnp.float32(1), jnp.float32(0.2), jnp.float32(0), jnp.float32(0.2))
    assert bool(TASK.is_near(journey))
    assert not bool(replace(TASK, strict=True).is_near(journey))
