"""The rover: how it drives, what it bumps into and sees, and PointNav in both ways to drive."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs_jax
from envs_jax.houses.camera import Camera
from envs_jax.houses.vision import DepthScale, DepthSensor
from envs_jax.physics.cameras import RoverCamera
from envs_jax.physics.navigation import LidarSensor, PointNav
from envs_jax.physics.rover import BODY, BOXES, RADIUS, Moves, Velocities
from jaxact.errors import JaxactError
from jaxact.testing import check_pomdp

KEY = jax.random.key(0)
MOVES = envs_jax.make("Physics-PointNav-v0")
AHEAD, LEFT, RIGHT, END = range(4)
reset = jax.jit(MOVES.reset)
step = jax.jit(MOVES.step)


@pytest.fixture(scope="module")
def episodes():
    return [reset(jax.random.key(seed)) for seed in range(8)]


def emptied(state, position=(0.0, 0.0, 0.0)):
    """The episode with its boxes out of the way."""
    world = state.environment
    away = world.mocap_position + jnp.float32([50, 0, 0])
    joints = jnp.asarray(position, jnp.float32)
    return replace(state, environment=replace(world, mocap_position=away, position=joints))


@pytest.mark.slow
def test_moves_are_as_long_as_they_are_said_to_be(episodes):
    state = emptied(episodes[0][0])
    places = []
    for action in (AHEAD, LEFT, LEFT, LEFT, AHEAD, RIGHT, END):
        state, result = step(KEY, state, jnp.int32(action))
        places.append(np.asarray(state.environment.position))
        assert float(result.metrics["collided"]) == 0
    # Within 1 % of a move: the wheels are led to its end for as long as a step lasts.
    np.testing.assert_allclose(places[0], [0.25, 0, 0], atol=2.5e-3)
    np.testing.assert_allclose(places[3], [0.25, 0, np.pi / 2], atol=5e-3)
    np.testing.assert_allclose(places[4], [0.25, 0.25, np.pi / 2], atol=1e-2)
    np.testing.assert_allclose(places[5], [0.25, 0.25, np.pi / 3], atol=1e-2)
    np.testing.assert_allclose(places[6], places[5], atol=1e-3)
    assert bool(result.terminated)
    assert float(result.metrics["path_length"]) == pytest.approx(0.5, abs=5e-3)


@pytest.mark.slow
def test_walls_and_boxes_stop_it(episodes):
    state = emptied(episodes[0][0], (2.0, 1.0, 0.0))
    for _ in range(4):
        state, result = step(KEY, state, jnp.int32(AHEAD))
    assert float(result.metrics["collided"]) == 1
    assert float(state.environment.position[0]) == pytest.approx(2.5 - RADIUS, abs=5e-3)
    boxed = replace(
        state.environment,
        position=jnp.zeros(3, jnp.float32),
        velocity=jnp.zeros(3, jnp.float32),
        mocap_position=state.environment.mocap_position.at[2].set(jnp.float32([0.8, 0, 0.3])),
        mocap_rotation=state.environment.mocap_rotation.at[2].set(jnp.float32([1, 0, 0, 0])),
    )
    state = replace(state, environment=boxed)
    for _ in range(4):
        state, result = step(KEY, state, jnp.int32(AHEAD))
    assert float(result.metrics["collided"]) == 1
    assert float(state.environment.position[0]) == pytest.approx(
        0.8 - BOXES[2][0] - RADIUS, abs=5e-3
    )


def test_the_lidar_sees_what_mujocos_rays_hit(episodes):
    model = MOVES.environment.model
    for state, observation in episodes[:3]:
        data = mujoco.MjData(model)
        data.qpos[:] = state.environment.position
        data.mocap_pos[:] = state.environment.mocap_position
        data.mocap_quat[:] = state.environment.mocap_rotation
        mujoco.mj_forward(model, data)
        body = model.body("rover").id
        angles = data.qpos[2] + np.linspace(0, 2 * np.pi, 24, endpoint=False)
        hit = np.zeros(1, np.int32)
        for angle, metres in zip(angles, observation["lidar"], strict=True):
            way = np.array([np.cos(angle), np.sin(angle), 0])
            far = mujoco.mj_ray(model, data, data.xpos[body], way, None, 1, body, hit, None)
            assert float(metres) == pytest.approx(min(far, 3.0), abs=1e-4)


def test_the_camera_sees_as_far_as_the_lidar(episodes):
    camera = Camera(9, 9, 60.0)
    depth = RoverCamera(DepthSensor(camera, BODY, DepthScale(0.0, 3.0), ranges=True))
    look, feel = jax.jit(depth.observe), jax.jit(LidarSensor(rays=1).observe)
    # The columns of a picture lead from left to right, the lidar's rays counterclockwise.
    across = np.arctan(np.tan(np.pi / 6) * (1 - np.arange(9) * 2 / 8) * 8 / 9)
    for state, observation in episodes[:3]:
        world = state.environment
        picture = look(world, state.task)
        assert picture.shape == (9, 9, 1)
        middle = np.asarray(picture)[4, :, 0]
        assert float(middle[4]) == pytest.approx(float(observation["lidar"][0]), abs=1e-4)
        for column in (0, 2, 7):
            turned = world.position.at[2].add(jnp.float32(across[column]))
            seen = feel(replace(world, position=turned), state.task)
            assert float(middle[column]) == pytest.approx(float(seen[0]), abs=1e-4)


def test_starts_are_free_and_goals_can_be_reached(episodes):
    for state, _ in episodes:
        model, data = MOVES.environment.model, mujoco.MjData(MOVES.environment.model)
        data.qpos[:] = state.environment.position
        data.mocap_pos[:] = state.environment.mocap_position
        data.mocap_quat[:] = state.environment.mocap_rotation
        mujoco.mj_forward(model, data)
        assert data.ncon == 0
        straight = np.linalg.norm(state.task.goal - state.environment.position[:2])
        way = float(state.task.journey.start_distance)
        assert max(1.0, straight - 1e-4) <= way < 20
        data.qpos[:2] = state.task.goal
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


@pytest.mark.slow
def test_who_ends_at_the_goal_succeeds_by_the_length_of_its_way(episodes):
    state, _ = episodes[0]
    goal = state.task.goal
    world = replace(state.environment, position=jnp.append(goal, jnp.float32(0)))
    task = replace(state.task, journey=replace(state.task.journey, walked=jnp.float32(10)))
    _, result = step(KEY, replace(state, environment=world, task=task), jnp.int32(END))
    assert bool(result.success)
    assert float(result.reward_terms["success"]) == 10
    spl = float(state.task.journey.start_distance) / 10
    assert float(result.metrics["spl"]) == pytest.approx(spl, abs=1e-3)
    _, result = step(KEY, state, jnp.int32(END))
    assert not bool(result.success)
    assert bool(result.terminated)


@pytest.mark.slow
def test_the_same_rover_is_driven_by_velocities():
    drive = Velocities()
    pomdp = envs_jax.make("Physics-PointNav-v0", control="velocities")
    assert pomdp.environment.source == MOVES.environment.source
    assert bool(drive.ends(jnp.float32([0.05, -0.05])))
    assert not bool(drive.ends(jnp.float32([0.05, -0.5])))
    world = pomdp.environment
    state, drive_on = reset(KEY)[0], jax.jit(world.step)
    state = emptied(state).environment
    for _ in range(10):
        state = drive_on(KEY, state, jnp.float32([1.0, 0.5]))
    # Two seconds on a circle: half a metre a second, three quarters of a radian a second.
    speed = float(jnp.linalg.norm(state.velocity[:2]))
    assert speed == pytest.approx(0.5, rel=0.02)
    assert float(state.velocity[2]) == pytest.approx(0.75, rel=0.02)


def test_wrong_controls_are_refused():
    with pytest.raises(JaxactError, match=r"unknown control of the rover 'move'.*'moves'"):
        envs_jax.make("Physics-PointNav-v0", control="move")
    with pytest.raises(JaxactError, match="unknown observation of the rover 'dept'"):
        envs_jax.make("Physics-PointNav-v0", observation=("dept",))
    with pytest.raises(JaxactError, match=r"task\.drive is Velocities"):
        replace(MOVES, task=PointNav(Velocities()))
    assert replace(MOVES, task=PointNav(Moves(), radius=0.3)).task.radius == 0.3


@pytest.mark.slow
@pytest.mark.parametrize("control", ["moves", "velocities"])
def test_it_is_sound(control):
    check_pomdp(envs_jax.make("Physics-PointNav-v0", control=control), lanes=2, steps=4)
