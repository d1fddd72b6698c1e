"""Sensors with cameras, their noise, and pictures."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.houses import categories, pictures
from envs_jax.houses.camera import Camera, eye
from envs_jax.houses.rays import CEILING, FIRST_BOX, FLOOR, look
from envs_jax.houses.sensor_noise import DisparityNoise, GaussianNoise, noise_key
from envs_jax.houses.vision import (
    ALLENACT_DEPTH,
    HABITAT_DEPTH,
    DepthSensor,
    GoalMaskSensor,
    InstanceSensor,
    MapSensor,
    RGBSensor,
    SemanticSensor,
)
from jaxact.errors import JaxactError
from jaxact.pomdp import Pictured
from tests.envs_jax.houses import random_scenes
from tests.envs_jax.houses.random_scenes import BODY

CAMERA = Camera(16, 16, 60)
SENSORS = {
    "depth": DepthSensor(CAMERA, BODY),
    "allenact": DepthSensor(CAMERA, BODY, ALLENACT_DEPTH),
    "habitat": DepthSensor(CAMERA, BODY, HABITAT_DEPTH),
    "ranges": DepthSensor(CAMERA, BODY, ranges=True),
    "noisy_depth": DepthSensor(CAMERA, BODY, noise=DisparityNoise()),
    "rgb": RGBSensor(CAMERA, BODY),
    "smooth": RGBSensor(CAMERA, BODY, rays=2),
    "noisy_rgb": RGBSensor(CAMERA, BODY, noise=GaussianNoise()),
    "semantic": SemanticSensor(CAMERA, BODY),
    "goal_mask": GoalMaskSensor(CAMERA, BODY),
    "instance": InstanceSensor(CAMERA, BODY),
    "map": MapSensor(21, 0.25, BODY),
}


@jax.jit
def observe(state):
    # The goal is a category of which the first box is.
    task_state = SimpleNamespace(category=state.scene.category[0])
    return {name: sensor.observe(state, task_state) for name, sensor in SENSORS.items()}


@pytest.fixture(scope="module")
def states():
    return [random_scenes.state(seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def readings(states):
    return jax.device_get([observe(state) for state in states])


def test_readings_lie_in_their_spaces(readings) -> None:
    for reading in readings:
        for name, sensor in SENSORS.items():
            assert reading[name].shape == sensor.space.shape, name
            assert reading[name].dtype == sensor.space.dtype, name
            assert sensor.space.contains(reading[name]), name


def test_scales_of_depth(readings) -> None:
    for reading in readings:
        depth = reading["depth"]
        np.testing.assert_allclose(reading["allenact"], np.minimum(depth, 5) * 4 - 2, rtol=1e-6)
        np.testing.assert_allclose(reading["habitat"], np.minimum(depth, 10) / 10, rtol=1e-6)
        assert np.all(reading["ranges"] >= depth)


def test_categories_are_those_of_the_instances(states, readings) -> None:
    for state, reading in zip(states, readings, strict=True):
        for number in np.unique(reading["instance"]):
            seen = np.unique(reading["semantic"][reading["instance"] == number])
            known = {FLOOR: "Floor", CEILING: "Ceiling"}
            if number in known:
                assert seen == categories.index(known[number])
            else:
                assert seen == int(state.scene.category[number - FIRST_BOX])


def test_goal_masks_show_the_category_sought(states, readings) -> None:
    seen = 0
    for state, reading in zip(states, readings, strict=True):
        expected = reading["semantic"] == int(state.scene.category[0])
        expected &= reading["instance"] >= FIRST_BOX
        np.testing.assert_array_equal(reading["goal_mask"][..., 0], expected)
        seen += expected.sum()
    assert 0 < seen < 3 * expected.size


def test_colors_are_of_the_surface_seen(states, readings) -> None:
    for state, reading in zip(states, readings, strict=True):
        number = int(np.bincount(reading["instance"].ravel()).argmax())
        gone = replace(state.scene, color=state.scene.color * 0, surface=state.scene.surface * 0)
        one = gone.color.at[max(number - FIRST_BOX, 0)].set(1.0)
        surface = gone.surface
        if number < FIRST_BOX:
            one, surface = gone.color, surface.at[number - 1].set(1.0)
        scene = replace(gone, color=one, surface=surface)
        lit = observe(replace(state, scene=scene))["rgb"]
        np.testing.assert_array_equal(np.any(lit > 0, axis=-1), reading["instance"] == number)


def test_averaged_rays_show_the_same_house(readings) -> None:
    for reading in readings:
        difference = reading["smooth"].astype(float) - reading["rgb"]
        assert np.abs(difference).mean() < 25
        assert np.any(difference != 0)


def test_sensors_share_the_rays_of_a_camera(states) -> None:
    shared = [SENSORS[name] for name in ("allenact", "semantic", "instance", "rgb")]

    def count_loops(sensors) -> int:
        def readings(state):
            return [sensor.observe(state, None) for sensor in sensors]

        compiled = jax.jit(readings).lower(states[0]).compile()
        return compiled.as_text().count(" while(")

    assert count_loops(shared) == count_loops(shared[:1]) > 0


@pytest.mark.slow
def test_readings_do_not_depend_on_the_batch(states, readings) -> None:
    @jax.jit
    @jax.vmap
    def observe(state):
        names = ("noisy_depth", "noisy_rgb", "map")
        return {name: SENSORS[name].observe(state, None) for name in names}

    batched = jax.device_get(observe(random_scenes.stacked([states[2], states[0]])))
    for place, lane in enumerate((2, 0)):
        for name, reading in batched.items():
            np.testing.assert_array_equal(reading[place], readings[lane][name], err_msg=name)


def test_gaussian_noise_has_its_moments() -> None:
    grey = jnp.full((64, 64, 3), 128, jnp.uint8)
    noise = GaussianNoise(0.05)
    apply = jax.jit(noise.apply)
    noisy = np.asarray(apply(jax.random.key(0), grey), np.float64)
    assert abs(noisy.mean() - 127.5) < 0.5
    assert abs(noisy.std() - 0.05 * 255) < 0.3
    bright = apply(jax.random.key(1), jnp.full((64, 64, 3), 255, jnp.uint8))
    assert np.mean(np.asarray(bright) == 255) > 0.4


def test_noise_is_a_function_of_pose_and_last_action(states) -> None:
    state = states[0]
    data = jax.jit(
        lambda state, stream: jax.random.key_data(noise_key(state, stream)), static_argnums=1
    )
    first = data(state, 0)
    np.testing.assert_array_equal(first, data(replace(state, scene=states[1].scene), 0))
    others = [data(state, 1)]
    others += [data(replace(state, last_action=jnp.int32(1)), 0)]
    others += [data(replace(state, yaw=state.yaw + 30), 0)]
    others += [data(replace(state, position=state.position + 0.01), 0)]
    for other in others:
        assert np.any(np.asarray(other) != np.asarray(first))


def redwood(depth: np.ndarray, table: np.ndarray | None, draws: np.ndarray) -> np.ndarray:
    """The Redwood model as habitat-sim computes it, pixel by pixel, with given normal draws."""
    height, width = depth.shape
    noisy = np.zeros_like(depth)
    for j, i in np.ndindex(depth.shape):
        y = int(np.clip(j + 0.25 * draws[0, j, i], 0, height - 1) + 0.5)
        x = int(np.clip(i + 0.25 * draws[1, j, i], 0, width - 1) + 0.5)
        true = depth[y - y % 2, x - x % 2]
        if true >= 10:
            continue
        factor = 1.0
        if table is not None:
            row = int(y / (height - 1) * 479 + 0.5) // 6
            column = int(x / (width - 1) * 639 + 0.5) // 8
            upper = int((true + 1) / 2)
            share = (true - (2 * (upper - 1) + 1)) / 2
            lower, higher = (table[row, column, min(max(k, 0), 4)] for k in (upper - 1, upper))
            factor = (1 - share) * lower + share * higher
            if factor < 1e-5:
                continue
        steps = np.round((35.130 * factor / true + 0.027778 * draws[2, j, i]) * 8)
        if steps > 0:
            noisy[j, i] = 35.130 * 8 / steps
    return noisy


@pytest.mark.parametrize("with_table", [False, True])
def test_disparity_noise_is_habitats(tmp_path, with_table: bool) -> None:
    random = np.random.default_rng(0)
    table = random.uniform(0.9, 1.1, (80, 80, 5)).astype(np.float32)
    table[::7] = 0
    path = tmp_path / "table.npy"
    np.save(path, table.reshape(80, 400))
    noise = DisparityNoise(str(path) if with_table else None)
    depth = random.uniform(0.3, 11, (24, 32)).astype(np.float32)
    key = jax.random.key(3)
    draws = np.asarray(jax.random.normal(key, (3, 24, 32), jnp.float32))
    expected = redwood(depth, table if with_table else None, draws)
    measured = np.asarray(jax.jit(noise.apply)(key, jnp.asarray(depth)))
    # Float32 and float64 may round to different steps now and then.
    assert np.mean(np.isclose(measured, expected, rtol=1e-5)) > 0.99
    assert np.mean(measured == 0) < 0.4


def test_tables_that_are_none_are_refused(tmp_path) -> None:
    apply = partial(jax.eval_shape, DisparityNoise("nowhere.npy").apply)
    with pytest.raises(JaxactError, match=r"no depth distortion table nowhere\.npy"):
        apply(jax.random.key(0), jnp.ones((4, 4)))
    path = tmp_path / "small.npy"
    np.save(path, np.ones((3, 4)))
    with pytest.raises(JaxactError, match=r"is \[80, 400\]; .* is \[3, 4\]"):
        jax.eval_shape(DisparityNoise(str(path)).apply, jax.random.key(0), jnp.ones((4, 4)))


def test_the_map_shows_what_stands_around(states) -> None:
    observe = jax.jit(SENSORS["map"].observe, static_argnums=1)
    for state in states:
        grid = np.asarray(observe(state, None))[..., 0]
        boxes = np.asarray(state.scene.boxes, np.float64)
        yaw = np.radians(float(state.yaw))
        for row, column in np.ndindex(grid.shape):
            ahead, right = 0.25 * (10 - row), 0.25 * (column - 10)
            x = float(state.position[0]) + ahead * np.sin(yaw) + right * np.cos(yaw)
            z = float(state.position[1]) + ahead * np.cos(yaw) - right * np.sin(yaw)
            dx, dz = x - boxes[:, 0], z - boxes[:, 2]
            local = boxes[:, 6] * dx - boxes[:, 7] * dz, boxes[:, 7] * dx + boxes[:, 6] * dz
            margin = [
                abs(a) - h - 0.125 for a, h in zip(local, (boxes[:, 3], boxes[:, 5]), strict=True)
            ]
            low = boxes[:, 1] - boxes[:, 4] < BODY.height
            present = low & (boxes[:, 1] > -100)
            outside = np.where(present, np.maximum(*margin), np.inf).min()
            if abs(outside) > 1e-4:
                assert grid[row, column] == (outside < 0)


@pytest.mark.slow
def test_pictures(states) -> None:
    state = states[0]
    assert all(isinstance(sensor, Pictured) for sensor in SENSORS.values())

    @jax.jit
    def draw(state, goal, line):
        camera = Camera(24, 32, 60)
        return (
            pictures.house_map(state.scene, pixels=64),
            pictures.house_map(
                state.scene, state, BODY, goal=goal, trajectory=line, path=line + 0.7, pixels=64
            ),
            pictures.overview(state, BODY, camera, rays=1),
            pictures.strip(state, BODY, CAMERA, goal=goal),
            SENSORS["semantic"].picture(state, None),
        )

    goal = jnp.float32([7.5, 7.5])
    line = jnp.float32([[1, 1], [4, 1], [jnp.nan, 1], [6, 6], [6, 7]])
    plain, full, overview, strip, semantic = map(np.asarray, draw(state, goal, line))
    assert plain.shape == full.shape == (64, 64, 3)
    pixel = lambda x, z: (int(32 - (z - 4) / 8.8 * 64), int(32 + (x - 4) / 8.8 * 64))  # noqa: E731
    assert tuple(full[pixel(7.5, 7.5)]) == (26, 166, 51)
    for place in ((2.5, 1), (6, 6.5)):
        assert tuple(full[pixel(*place)]) == (38, 89, 230), place
    assert tuple(full[pixel(5, 3)]) != (38, 89, 230)
    assert np.any(
        full[pixel(*np.asarray(state.position))] != plain[pixel(*np.asarray(state.position))]
    )
    assert overview.shape == (24, 32, 3)
    reds = (overview[..., 0] > 100) & (overview[..., 1] < 60) & (overview[..., 2] < 60)
    assert reds.any()
    assert strip.shape == (256, 4 * 256 + 24, 3)
    assert semantic.shape == (256, 256, 3)


def test_sizes_that_cannot_be_are_refused() -> None:
    with pytest.raises(JaxactError, match="rays must be at least 1"):
        RGBSensor(CAMERA, BODY, rays=0)
    with pytest.raises(JaxactError, match="a map needs cells"):
        MapSensor(0, 0.1, BODY)


def test_sensors_see_from_the_eye(states, readings) -> None:
    view = jax.jit(partial(look, CAMERA))(eye(states[0], BODY), states[0].scene)
    np.testing.assert_array_equal(view.depth, readings[0]["depth"][..., 0])
    np.testing.assert_array_equal(view.surface, readings[0]["instance"])
