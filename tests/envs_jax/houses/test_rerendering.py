"""Frames that the model renders are those that the cameras would have stored."""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.camera import Camera
from envs_jax.houses.rerendering import Rerendered
from envs_jax.houses.viewpoint import ViewpointSensor
from envs_jax.houses.vision import DepthSensor, RGBSensor, SemanticSensor
from tests.envs_jax.houses.random_scenes import BODY, state

CAMERA = Camera(8, 10)
SENSORS = {
    "depth": DepthSensor(CAMERA, BODY),
    "rgb": RGBSensor(CAMERA, BODY),
    "semantic": SemanticSensor(CAMERA, BODY),
}


class Everything(nn.Module):
    """Lays what it reads out flat."""

    def __call__(self, observation):
        assert sorted(observation) == ["depth", "goal", "rgb", "semantic"]
        lead = observation["goal"].shape[:-1]
        ordered = [x for _, x in sorted(observation.items())]
        flat = [x.astype(jnp.float32).reshape(*lead, -1) for x in ordered]
        return jnp.concatenate(flat, axis=-1)


def test_frames_rendered_again_are_those_seen():
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[state(seed) for seed in range(6)])
    sensor = ViewpointSensor(boxes=states.scene.boxes.shape[1])

    @jax.jit
    def read(states):
        frames = jax.vmap(
            lambda s: {name: sensor.observe(s, None) for name, sensor in SENSORS.items()}
        )(states)
        return frames, jax.vmap(lambda s: sensor.observe(s, None))(states)

    frames, viewpoint = read(states)
    assert viewpoint.shape[1:] == sensor.space.shape
    goal = jnp.ones((6, 2), jnp.float32)
    seen = Everything()({**frames, "goal": goal})
    again = jax.jit(lambda x: Rerendered(SENSORS, Everything()).apply({}, x))
    lanes = again({"viewpoint": viewpoint, "goal": goal})
    width = sum(frames[name][0].size for name in frames) + 2
    assert lanes.shape == (6, width)
    np.testing.assert_array_equal(lanes, seen)
    # Time and lanes ahead: as a rollout has them.
    steps = jax.tree.map(lambda x: x.reshape(3, 2, *x.shape[1:]), (viewpoint, goal))
    in_time = again({"viewpoint": steps[0], "goal": steps[1]})
    np.testing.assert_array_equal(in_time.reshape(6, -1), lanes)
