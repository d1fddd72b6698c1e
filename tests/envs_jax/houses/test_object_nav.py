"""Visibility by AI2-THOR's rule, ObjectNav, its sensors, and the experts of both tasks."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_houses import BODY, ROOMS, cluttered, free_plans, walls

from envs_jax.houses import presets
from envs_jax.houses.categories import index
from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import MARGIN, GoalField, build_roadmap, goal_field
from envs_jax.houses.journey import Journey
from envs_jax.houses.point_nav import PointNavState
from envs_jax.houses.scene import make_scene
from envs_jax.houses.sensors import GPSCompassSensor, ObjectGoalSensor, PointGoalSensor
from envs_jax.houses.visibility import ROBOTHOR_SIGHT, is_visible
from jaxact import JaxactError

MUG = index("Mug")
# A mug on a table, and a screen in front of it.
TABLE = [(1, 0.3, 2, 0.6, 0.6, 0.6, 0), (1, 0.66, 2, 0.1, 0.12, 0.1, 0)]
SCREEN = (1, 0.5, 1.6, 1, 1, 0.02, 0)
KINDS = [index("DiningTable"), MUG, index("Wall")]


@pytest.fixture(scope="module")
def sees():
    @jax.jit
    def run(scene, position, yaw, pitch):
        wanted = (scene.category == MUG) & scene.present
        return is_visible(ROBOTHOR_SIGHT, BODY, scene.boxes, wanted, position, yaw, pitch)

    def look(boxes, position, yaw=0.0, pitch=0.0):
        scene = make_scene(boxes, KINDS[: len(boxes)], ROOMS, size=3)
        plan = np.array(position, np.float32)
        return bool(run(scene, plan, np.float32(yaw), np.float32(pitch)))

    return look


def test_what_is_near_in_front_and_not_hidden_is_visible(sees):
    assert sees(TABLE, (1, 1.3))
    assert not sees([*TABLE, SCREEN], (1, 1.3))
    assert not sees(TABLE, (1, 1.3), yaw=90)
    assert not sees(TABLE, (1, 1.3), pitch=60)
    # Its nearest face is 0.955 m from the axis, but more than 1 m from the camera.
    assert sees(TABLE, (1, 1.02))
    assert not sees(TABLE, (1, 0.9))


def test_point_goals_are_told_in_each_convention():
    field = GoalField(jnp.zeros((1, 2), jnp.float32), jnp.zeros(1, jnp.float32))
    zero = jnp.float32(0)
    goal, start = jnp.array([2, 1], jnp.float32), jnp.array([1, 0, 30], jnp.float32)
    task_state = PointNavState(goal, start, Journey(field, zero, zero, zero, zero))
    house = House(BODY, ("move_ahead", "rotate_left", "rotate_right", "end"))
    scene = make_scene(TABLE, KINDS[:2], ROOMS)

    @jax.jit
    def read():
        state = house.start(scene, jnp.array([1, 1], jnp.float32), 0.0)
        sensors = [PointGoalSensor(name) for name in ("allenact", "habitat", "cartesian")]
        return [sensor.observe(state, task_state) for sensor in (*sensors, GPSCompassSensor())]

    # The goal is a metre to the right.
    allenact, habitat, cartesian, gps = read()
    np.testing.assert_allclose(allenact, [1, -np.pi / 2], atol=1e-5)
    np.testing.assert_allclose(habitat, [1, np.pi / 2], atol=1e-5)
    np.testing.assert_allclose(cartesian, [0, 1], atol=1e-5)
    # Ahead of the start, and to the left of where it faced: now it faces 30 degrees less.
    half, root = 0.5, np.sqrt(3) / 2
    np.testing.assert_allclose(gps, [root, -half, root, -half], atol=1e-5)
    with pytest.raises(JaxactError, match="habitat"):
        PointGoalSensor("habitta")
    with pytest.raises(JaxactError, match="Mug"):
        ObjectGoalSensor(("Mgu",))


def test_presets_have_their_numbers():
    robothor, habitat = presets.object_nav("robothor"), presets.object_nav("habitat")
    assert (robothor.house.turn, robothor.sight.distance, robothor.rule) == (30, 1, "visible")
    assert (habitat.rule, habitat.radius, habitat.house.collision) == ("view_point", 0.1, "slide")
    assert presets.object_nav("ithor").refusal_penalty == -0.03
    assert presets.point_nav("habitat").success_reward == 2.5
    assert presets.point_nav("habitat").house.turn == 10
    assert presets.point_nav("robothor").success_reward == 10
    with pytest.raises(JaxactError, match="habitat"):
        presets.point_nav("habitta")
    with pytest.raises(JaxactError, match="view_point"):
        replace(robothor, rule="view_points")


def follow(task, episodes, horizon):
    """Follows the task's expert through a batch; returns the SPL of each episode."""
    house = task.house

    def one(key, state, task_state):
        action = task.expert(key, task_state, state).action
        after = house.step(key, state, action)
        task_state, outcome = task.step(task_state, state, action, after)
        return after, task_state, outcome

    @jax.jit
    def run(key, state, task_state):
        done = jnp.zeros(state.yaw.shape, bool)

        def step(carry, key):
            state, task_state, done, spl = carry
            keys = jax.random.split(key, done.shape[0])
            after, progress, outcome = jax.vmap(one)(keys, state, task_state)
            spl = jnp.where(done, spl, outcome.metrics["spl"])
            held = (state, task_state)
            state, task_state = jax.tree.map(
                lambda old, new: jnp.where(done.reshape(-1, *[1] * (new.ndim - 1)), old, new),
                held,
                (after, progress),
            )
            done |= outcome.terminated
            return (state, task_state, done, spl), outcome.reward["shaping"]

        first = (state, task_state, done, done.astype(jnp.float32))
        (_, _, _, spl), shaping = jax.lax.scan(step, first, jax.random.split(key, horizon))
        return spl, shaping

    spl, shaping = map(np.asarray, run(jax.random.key(0), *episodes))
    # Within the margin of the roadmap distances jump.
    assert np.all(np.abs(shaping) <= house.step_size + 2 * MARGIN)
    return spl


def field_of(body, scene, goals, present=None):
    """How far goals are in a scene."""
    boxes = obstacles(scene.boxes, body)
    return goal_field(build_roadmap(scene, body, 128), boxes, body.radius, goals, present)


def point_episodes(task, seeds, each, room):
    """Episodes in cluttered houses with so much more room than the body needs."""
    wide = replace(task.house.body, radius=task.house.body.radius + room)

    @jax.jit
    def begin(scene, start, goal):
        state = task.house.start(scene, start)
        broad = replace(task, house=replace(task.house, body=wide))
        fits = broad.start(field_of(wide, scene, goal[None]), state, goal).journey.start_distance
        field = field_of(task.house.body, scene, goal[None])
        return state, task.start(field, state, goal), jnp.isfinite(fits)

    found = []
    for seed in seeds:
        scene = cluttered(seed)
        boxes = np.asarray(jax.jit(lambda scene=scene: obstacles(scene.boxes, wide))())
        plans = free_plans(seed, boxes, wide.radius, 4 * each)
        episodes = [begin(scene, *plans[2 * i : 2 * i + 2]) for i in range(2 * each)]
        found += [episode[:2] for episode in episodes if episode[2]][:each]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["robothor", "habitat"])
def test_point_experts_arrive_where_there_is_a_little_room(name):
    task = presets.point_nav(name)
    spl = follow(task, point_episodes(task, range(4), 12, room=0.08), 200)
    print(f"{name}: {len(spl)} episodes, success {np.mean(spl > 0):.4f}, SPL {spl.mean():.4f}")
    assert np.mean(spl > 0) == 1
    assert spl.mean() >= 0.97


def object_episodes(task, count):
    scene = make_scene(
        [*walls(), (6, 0.3, 4, 0.6, 0.6, 0.6, 20), (6, 0.66, 4, 0.1, 0.12, 0.1, 0)],
        [index("Wall")] * 7 + KINDS[:2],
        ROOMS,
    )

    @jax.jit
    def begin(start, yaw):
        state = task.house.start(scene, start, yaw, 30.0)
        field = field_of(task.house.body, scene, *task.goals(scene, jnp.int32(MUG)))
        return state, task.start(field, state, jnp.int32(MUG))

    rng = np.random.default_rng(0)
    starts = rng.uniform((0.4, 0.4), (3.5, 4.6), (count, 2)).astype(np.float32)
    yaws = (30 * rng.integers(0, 12, count)).astype(np.float32)
    return jax.vmap(begin)(starts, yaws)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["robothor", "habitat"])
def test_object_experts_find_a_mug_in_the_other_room(name):
    task = presets.object_nav(name)
    spl = follow(task, object_episodes(task, 8), 80)
    print(f"{name}: {len(spl)} episodes, success {np.mean(spl > 0):.4f}, SPL {spl.mean():.4f}")
    assert np.mean(spl > 0) == 1
    assert spl.mean() >= 0.9
