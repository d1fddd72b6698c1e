"""The ray caster against MuJoCo's, against another in float64, and against what geometry says."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from envs_jax.houses import rays
from envs_jax.houses.camera import Camera, Pose, eye
from envs_jax.houses.rays import CEILING, FIRST_BOX, FLOOR, NOTHING, View, locate, look
from envs_jax.houses.scene import Scene, box
from jaxact.errors import JaxactError
from tests.envs_jax.houses import random_scenes

CAMERA = Camera(height=24, width=32, vertical_fov=63.453)


@jax.jit
def see(pose: Pose, scene: Scene):
    view = look(CAMERA, pose, scene)
    return view, locate(CAMERA, pose, scene, view)


def views(seeds: range):
    for seed in seeds:
        state = random_scenes.state(seed)
        pose = eye(state, random_scenes.BODY)
        yield pose, state.scene, *jax.device_get(see(pose, state.scene))


def inside(pose: Pose, scene: Scene) -> bool:
    """Whether the camera is in a box (or very near one)."""
    values = np.asarray(scene.boxes, np.float64)
    x, y, z = (values[:, :3] - np.asarray(pose.position)).T
    local = np.stack([values[:, 6] * x - values[:, 7] * z, y, values[:, 7] * x + values[:, 6] * z])
    return bool(np.any(np.all(np.abs(local) < values[:, 3:6].T + 0.02, axis=0)))


def test_depths_and_surfaces_are_those_of_another_caster_in_float64() -> None:
    wrong, off, total = 0, 0, 0
    for pose, scene, view, hits in views(range(12)):
        rays = random_scenes.directions(CAMERA, pose)
        origin = np.asarray(pose.position, np.float64)
        depth, surface = random_scenes.cast(origin, rays, scene, CAMERA.near)
        same = view.surface == surface
        wrong, total = wrong + np.sum(~same), total + same.size
        # Rounding to the bits of a key, and what float32 loses on rays that graze a face.
        np.testing.assert_allclose(view.depth[same], depth[same], rtol=1.8e-5, atol=2e-5)
        np.testing.assert_allclose(hits.depth[same], depth[same], rtol=5e-6, atol=2e-5)
        off += np.sum(~np.isclose(view.depth[same], depth[same], rtol=1.8e-5, atol=1e-6))
    assert wrong <= 1e-3 * total
    assert off <= 2e-4 * total


def test_depths_and_surfaces_are_those_of_mujoco() -> None:
    wrong, total = 0, 0
    for pose, scene, view, _ in views(range(6)):
        if inside(pose, scene):  # MuJoCo sees the inner faces of boxes.
            continue
        model, data = to_mujoco(scene)
        origin = to_right_handed(np.asarray(pose.position, np.float64))
        rays = to_right_handed(random_scenes.directions(CAMERA, pose))
        geom = np.zeros(1, np.int32)
        for index in np.ndindex(view.depth.shape):
            ray, length = rays[index], np.linalg.norm(rays[index])
            far = mujoco.mj_ray(model, data, origin, ray / length, None, 1, -1, geom, None)
            total += 1
            if geom[0] + 1 == view.surface[index]:
                assert abs(far / length - view.depth[index]) < 1e-3
            else:
                wrong += 1
    assert total >= 3 * CAMERA.height * CAMERA.width
    assert wrong <= 1e-3 * total


def to_right_handed(vectors: np.ndarray) -> np.ndarray:
    """Vectors in MuJoCo's frame: its x, y, z are our x, z, y."""
    return vectors[..., [0, 2, 1]]


def to_mujoco(scene: Scene):
    """The same house: geom 0 is the floor, geom 1 the ceiling, and the boxes follow."""
    spec = mujoco.MjSpec()
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(type=plane, size=[0, 0, 1])
    above = [0, 0, float(scene.ceiling)]
    spec.worldbody.add_geom(type=plane, size=[0, 0, 1], pos=above, quat=[0, 1, 0, 0])
    for values in np.asarray(scene.boxes, np.float64)[np.asarray(scene.present)]:
        half_turn = np.arctan2(values[7], values[6]) / 2
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=to_right_handed(values[:3]),
            size=to_right_handed(values[3:6]),
            # Clockwise from above is a negative turn about MuJoCo's upward z.
            quat=[np.cos(half_turn), 0, 0, -np.sin(half_turn)],
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def empty_scene(height: float = 2.6) -> Scene:
    scene = random_scenes.scene(0)
    gone = scene.boxes.at[:, 1].set(-1e4)
    return replace(scene, boxes=gone, ceiling=jnp.float32(height))


def pose_at(x: float, y: float, z: float, yaw: float = 0, pitch: float = 0) -> Pose:
    return Pose(jnp.float32([x, y, z]), jnp.float32(yaw), jnp.float32(pitch))


@pytest.mark.parametrize("pitch", [-40, 0, 30])
def test_floor_and_ceiling_are_where_geometry_says(pitch: float) -> None:
    pose = pose_at(3, 1.1, 4, 77, pitch)
    view, hits = see(pose, empty_scene())
    rays = random_scenes.directions(CAMERA, pose)
    expected = np.where(rays[..., 1] < 0, -1.1, 1.5) / rays[..., 1]
    np.testing.assert_allclose(view.depth, expected, rtol=2e-5)
    np.testing.assert_allclose(hits.depth, expected, rtol=1e-5)
    np.testing.assert_array_equal(view.surface, np.where(rays[..., 1] < 0, FLOOR, CEILING))
    plan = np.array([3, 4]) + expected[..., None] * rays[..., [0, 2]]
    np.testing.assert_allclose(np.stack([hits.u, hits.v], -1), plan, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(hits.face, np.where(rays[..., 1] < 0, 2, 3))


def test_nothing_is_infinitely_far() -> None:
    # From above the ceiling one looks down into the house, and up into nothing.
    view, hits = see(pose_at(0, 5, 0), empty_scene())
    upper = slice(0, CAMERA.height // 2)
    assert np.all(np.isinf(view.depth[upper]))
    assert np.all(np.isinf(hits.depth[upper]))
    assert np.all(view.surface[upper] == NOTHING)
    assert np.all(view.surface[CAMERA.height // 2 :] == FLOOR)
    assert np.all(np.isfinite(hits.u)) & np.all(np.isfinite(hits.v))


def one_box(center, half_size, yaw: float = 0) -> Scene:
    scene = empty_scene()
    row = box(jnp.float32(center), jnp.float32(half_size), jnp.float32(yaw))
    return replace(scene, boxes=scene.boxes.at[5].set(row))


def test_faces_and_their_coordinates() -> None:
    scene = one_box([0.1, 1.2, 3], [1, 1.2, 0.5])
    view, hits = see(pose_at(0, 1, 0), scene)
    row, column = CAMERA.height // 2, CAMERA.width // 2
    assert view.surface[row, column] == FIRST_BOX + 5
    assert hits.face[row, column] == 5  # It looks along −z.
    right, up = 2.5 * np.tan(np.radians(63.453 / 2)) / CAMERA.height * np.array([1, -1])
    np.testing.assert_allclose(
        [hits.u[row, column], hits.v[row, column]], [right - 0.1, up - 0.2], atol=1e-5
    )
    # Seen from the right, turned: its face along +x.
    _, hits = see(pose_at(4, 1, 3, -90), scene)
    assert hits.face[row, column] == 0
    np.testing.assert_allclose(hits.depth[row, column], 2.9, rtol=1e-6)
    np.testing.assert_allclose(
        [hits.u[row, column], hits.v[row, column]],
        [2.9 / 2.5 * right, 2.9 / 2.5 * up - 0.2],
        atol=1e-5,
    )
    # The box turned by 90 degrees shows the same from z.
    _, hits = see(pose_at(0.1, 1, 0), one_box([0.1, 1.2, 3], [1, 1.2, 0.5], 90))
    np.testing.assert_allclose(hits.depth[row, column], 2, rtol=1e-6)
    assert hits.face[row, column] == 0


def test_rays_along_faces_and_from_within() -> None:
    # An odd picture has rays with components that are exactly zero; they run along faces.
    see = jax.jit(partial(look, Camera(5, 5, 90)))
    for x in (-0.999, 0.0, 0.999):
        view = see(pose_at(x, 1, 0), one_box([0, 1, 3], [1, 1, 1]))
        assert view.surface[2, 2] == FIRST_BOX + 5
        np.testing.assert_allclose(view.depth[2, 2], 2, rtol=2e-5)
    for x in (-1.1, 1.1):
        assert see(pose_at(x, 1, 0), one_box([0, 1, 3], [1, 1, 1])).surface[2, 2] != 8
    view = see(pose_at(0, 1, 3), one_box([0, 1, 3], [1, 1, 1]))
    assert np.all(view.surface < FIRST_BOX)


def turned_scene(scene: Scene, pose: Pose, degrees: float) -> tuple[Scene, Pose]:
    """The house and the camera, turned together about the house's origin."""
    angle = np.radians(degrees)

    def turn(x, z):
        return np.cos(angle) * x + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * x

    b = np.asarray(scene.boxes, np.float64)
    yaws = np.degrees(np.arctan2(b[:, 7], b[:, 6])) + degrees
    x, z = turn(b[:, 0], b[:, 2])
    center = np.where(np.asarray(scene.present)[:, None], np.stack([x, b[:, 1], z], -1), b[:, :3])
    boxes = box(*(jnp.asarray(v, jnp.float32) for v in (center, b[:, 3:6], yaws)))
    x, z = turn(float(pose.position[0]), float(pose.position[2]))
    position = jnp.float32([x, pose.position[1], z])
    return replace(scene, boxes=boxes), replace(pose, position=position, yaw=pose.yaw + degrees)


def same_picture(one, other) -> None:
    same = np.asarray(one.surface == other.surface)
    assert np.mean(same) > 0.998
    np.testing.assert_allclose(one.depth[same], other.depth[same], rtol=1e-4, atol=1e-5)


def test_turning_house_and_camera_together_changes_nothing() -> None:
    for degrees, (pose, scene, view, _) in zip((90, 37, 251), views(range(3)), strict=True):
        turned, turned_pose = turned_scene(scene, pose, degrees)
        same_picture(view, see(turned_pose, turned)[0])


def test_the_mirrored_house_is_seen_mirrored() -> None:
    for pose, scene, view, _ in views(range(3)):
        flip = jnp.float32([-1, 1, 1, 1, 1, 1, 1, -1])
        mirrored = replace(scene, boxes=scene.boxes * flip)
        position = pose.position * jnp.float32([-1, 1, 1])
        other, _ = see(replace(pose, position=position, yaw=-pose.yaw), mirrored)
        same_picture(view, jax.tree.map(lambda x: x[:, ::-1], other))


def test_range_is_depth_times_the_length_of_the_ray() -> None:
    for pose, scene, view, _ in views(range(2)):
        rays = random_scenes.directions(CAMERA, pose)
        lengths = CAMERA.rays(pose.pitch).lengths
        np.testing.assert_allclose(lengths, np.linalg.norm(rays, axis=-1), rtol=1e-6)
        unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        origin = np.asarray(pose.position, np.float64)
        ranges, surface = random_scenes.cast(origin, unit, scene, CAMERA.near)
        same = surface == view.surface
        np.testing.assert_allclose((view.depth * lengths)[same], ranges[same], rtol=2e-5)


def test_frames_do_not_depend_on_the_batch() -> None:
    states = [random_scenes.state(seed) for seed in range(7)]
    batch = random_scenes.stacked([(eye(s, random_scenes.BODY), s.scene) for s in states])
    together = jax.device_get(jax.jit(jax.vmap(lambda pair: see(*pair)))(batch))
    for lane in (0, 3, 6):
        alone, hits_alone = jax.device_get(see(*jax.tree.map(lambda x, lane=lane: x[lane], batch)))
        view, hits = jax.tree.map(lambda x, lane=lane: x[lane], together)
        np.testing.assert_array_equal(view.depth, alone.depth)
        np.testing.assert_array_equal(view.surface, alone.surface)
        # XLA joins products and sums into one rounding where it likes.
        np.testing.assert_array_equal(hits.face, hits_alone.face)
        np.testing.assert_allclose(hits.depth, hits_alone.depth, rtol=1e-6)
        np.testing.assert_allclose(hits.u, hits_alone.u, atol=2e-6)
        np.testing.assert_allclose(hits.v, hits_alone.v, atol=2e-6)


@pytest.mark.parametrize("rays_a_core", [1, 3 * CAMERA.height * CAMERA.width])
def test_frames_do_not_depend_on_those_taken_with_them(monkeypatch, rays_a_core: int) -> None:
    states = [random_scenes.state(seed) for seed in range(7)]
    batch = random_scenes.stacked([(eye(s, random_scenes.BODY), s.scene) for s in states])
    expected = jax.device_get(jax.jit(jax.vmap(lambda pair: look(CAMERA, *pair)))(batch))
    monkeypatch.setattr(rays, "_RAYS_A_CORE", rays_a_core)
    found = jax.device_get(jax.jit(jax.vmap(lambda pair: look(CAMERA, *pair)))(batch))
    jax.tree.map(np.testing.assert_array_equal, found, expected)


def test_boxes_out_of_sight_are_left_out_and_would_not_be_seen(monkeypatch) -> None:
    states = [
        random_scenes.state(seed, pitch=pitch)
        for seed in range(8)
        for pitch in (-88.0, -45.0, 0.0, 30.0, 70.0)
    ]
    batch = random_scenes.stacked([(eye(s, random_scenes.BODY), s.scene) for s in states])

    def looked() -> View:
        return jax.device_get(jax.jit(jax.vmap(lambda pair: look(CAMERA, *pair)))(batch))

    def in_sight(pose: Pose, scene: Scene) -> jax.Array:
        return rays._in_sight(pose, CAMERA.rays(pose.pitch), scene.boxes)

    kept = np.asarray(jax.jit(jax.vmap(in_sight))(*batch)).reshape(8, 5, -1)
    steep, level = kept[:, [0, 4]], kept[:, 2:4]
    assert np.all(steep)
    assert 0.1 < level.mean() < 0.4
    found = looked()
    monkeypatch.setattr(rays, "_in_sight", lambda pose, rays, boxes: jnp.ones(len(boxes), bool))
    jax.tree.map(np.testing.assert_array_equal, found, looked())


def test_the_first_of_a_mask() -> None:
    mask = np.random.default_rng(0).random((5, 9)) < [[0.0], [0.2], [0.5], [0.8], [1.0]]
    order, count = jax.device_get(rays._first_those(jnp.asarray(mask)))
    assert order.shape == (5, 10)
    np.testing.assert_array_equal(count, mask.sum(axis=1))
    for row, those, many in zip(mask, order, count, strict=True):
        np.testing.assert_array_equal(those[:many], np.flatnonzero(row))
        assert not np.any(those[many:])


def test_depth_can_be_differentiated() -> None:
    camera = Camera(4, 4, 60)

    @jax.jit
    @partial(jax.grad, has_aux=True)
    def gradient(pose: Pose, scene: Scene):
        depth = locate(camera, pose, scene, look(camera, pose, scene)).depth
        return jnp.mean(depth), depth

    # A wall ahead fills the picture.
    slope, depth = gradient(pose_at(0, 1, 0), one_box([0, 1.2, 2], [3, 3, 0.5]))
    np.testing.assert_allclose(depth, 1.5, rtol=1e-6)
    np.testing.assert_allclose(slope.position, [0, 0, -1], atol=1e-6)
    slope, _ = gradient(pose_at(3.7, 0.9, 2.9, 40, 20), random_scenes.scene(3))
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope))


def test_many_boxes_have_longer_numbers() -> None:
    see = jax.jit(partial(look, Camera(16, 16, 70)))
    few = random_scenes.scene(5, boxes=242, padding=6)
    more = random_scenes.scene(5, boxes=242, padding=22)
    pose = pose_at(4, 1, 4, 10)
    one, other = see(pose, few), see(pose, more)
    np.testing.assert_array_equal(one.surface, other.surface)
    np.testing.assert_allclose(one.depth, other.depth, rtol=1.5e-4)
    with pytest.raises(JaxactError, match="at most 1021 boxes; got 1026"):
        jax.eval_shape(see, pose, random_scenes.scene(0, 1000, 26))


def test_cameras_that_cannot_be_are_refused() -> None:
    for fields, message in [
        ({"height": 0, "width": 4}, "at least one pixel"),
        ({"height": 4, "width": 4, "vertical_fov": 180}, "between 0 and 180"),
        ({"height": 4, "width": 4, "horizontal_fov": -3}, "between 0 and 180"),
        ({"height": 4, "width": 4, "near": 0}, "near must be positive"),
    ]:
        with pytest.raises(JaxactError, match=message):
            Camera(**fields)


def test_fields_of_view() -> None:
    square = Camera(30, 40, 60)
    up, right = square.extent
    np.testing.assert_allclose([up, right], [np.tan(np.pi / 6), np.tan(np.pi / 6) * 4 / 3])
    squeezed = Camera(24, 24, 63.453, 79)
    np.testing.assert_allclose(
        squeezed.extent, [np.tan(np.radians(63.453 / 2)), np.tan(np.radians(39.5))]
    )
    assert squeezed.finer(2) == Camera(48, 48, 63.453, 79)
