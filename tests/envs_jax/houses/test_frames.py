"""Poses in Habitat's frame."""

import jax.numpy as jnp
import numpy as np

from envs_jax.houses.frames import from_habitat, to_habitat
from envs_jax.houses.scene import forward


def rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotates by the definition, q v q*."""
    axis, w = quaternion[:3], quaternion[3]
    turned = np.cross(axis, np.cross(axis, vector) + w * vector)
    return vector + 2 * turned


def test_poses_come_back() -> None:
    random = np.random.default_rng(0)
    position = random.uniform(-5, 5, (50, 3))
    yaw = np.concatenate([random.uniform(0, 360, 44), [0, 90, 180, 270, 359.999, 30]])
    place, rotation = to_habitat(position, yaw)
    assert np.all(rotation[:, 3] >= 0)
    np.testing.assert_allclose(np.linalg.norm(rotation, axis=-1), 1)
    back, yaw_back = from_habitat(place, rotation)
    np.testing.assert_array_equal(back, position)
    np.testing.assert_allclose((yaw_back - yaw + 180) % 360, 180, atol=1e-9)
    assert np.all((yaw_back >= 0) & (yaw_back < 360))


def test_forward_is_forward_in_both_frames() -> None:
    for yaw in (0.0, 30.0, 90.0, 200.0, 300.0):
        _, rotation = to_habitat([0, 0, 0], yaw)
        x, y, z = rotate(rotation, np.array([0.0, 0, -1]))
        right, ahead = forward(jnp.float32(yaw))
        np.testing.assert_allclose([x, y, -z], [right, 0, ahead], atol=1e-6)


def test_known_poses_of_habitat() -> None:
    # No rotation looks along −z; a quarter turn counter-clockwise looks along −x.
    half = np.sqrt(0.5)
    place, yaw = from_habitat(
        [[1, 2, 3], [1, 2, 3], [0, 0, 0]],
        [[0, 0, 0, 1], [0, half, 0, half], [0, -2 * half, 0, -2 * half]],
    )
    np.testing.assert_array_equal(place[0], [1, 2, -3])
    np.testing.assert_allclose(yaw, [0, 270, 270])


def test_a_tilted_camera_still_has_its_heading() -> None:
    # A turn by 40 degrees clockwise after a look down by 30.
    turn, tilt = np.radians(-20), np.radians(-15)
    yawed, tilted = (
        np.array([0, np.sin(turn), 0, np.cos(turn)]),
        np.array([np.sin(tilt), 0, 0, np.cos(tilt)]),
    )
    vector = yawed[3] * tilted[:3] + tilted[3] * yawed[:3] + np.cross(yawed[:3], tilted[:3])
    both = np.array([*vector, yawed[3] * tilted[3] - yawed[:3] @ tilted[:3]])
    np.testing.assert_allclose(from_habitat(np.zeros(3), both)[1], 40)
