"""Frames that are not stored: the rollout keeps where the agent was, and the model looks again.

A frame is a function of the house and of the agent's pose, and to compute it again is cheap beside
what a network does with it. With `ViewpointSensor` in place of camera sensors and `Rerendered`
around the encoder, what a rollout holds of each step is a few kilobytes whatever the resolution:

    sensors = {"viewpoint": ViewpointSensor(boxes=64), "point_goal": ...}
    encoder = Rerendered({"depth": DepthSensor(camera, body)}, Concatenated({...}))
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.scene import Scene
from envs_jax.houses.state import HouseState
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Box

# Columns of a box: its pose and size, category and colour.
_BOX = 8 + 1 + 3
# The ceiling, the planes' colours, the agent's plan, yaw, pitch and last action.
_REST = 1 + 6 + 2 + 1 + 1 + 1


@dataclass(frozen=True)
class ViewpointSensor(Sensor):
    """All that a camera's frame depends on, float32 [12 N + 12].

    Attributes:
      boxes: N, rows of the scene.
    """

    boxes: int

    @property
    def space(self) -> Box:
        """Numbers of several kinds; `state_at` takes them apart."""
        return Box(-np.inf, np.inf, (_BOX * self.boxes + _REST,))

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the house and the agent's pose side by side."""
        del task_state
        scene = state.scene
        category = scene.category.astype(jnp.float32)[:, None]
        rest = [scene.ceiling, state.yaw, state.pitch, state.last_action.astype(jnp.float32)]
        return jnp.concatenate(
            [
                jnp.concatenate([scene.boxes, category, scene.color], axis=1).reshape(-1),
                scene.surface.reshape(-1),
                state.position,
                jnp.stack(rest),
            ]
        )


def state_at(viewpoint: jax.Array) -> HouseState:
    """Returns the state that a `ViewpointSensor` read, as far as cameras can tell.

    Args:
      viewpoint: float32 [12 N + 12].
    """
    count = (viewpoint.shape[0] - _REST) // _BOX
    table, rest = viewpoint[: _BOX * count].reshape(count, _BOX), viewpoint[_BOX * count :]
    no = jnp.zeros(count, bool)
    scene = Scene(
        boxes=table[:, :8],
        other_boxes=table[:, :8],
        category=table[:, 8].astype(jnp.int32),
        color=table[:, 9:],
        openable=no,
        portable=no,
        opened=no,
        rooms=jnp.zeros((0, 4), jnp.float32),
        room_kind=jnp.zeros(0, jnp.int32),
        ceiling=rest[8],
        surface=rest[:6].reshape(2, 3),
    )
    return HouseState(
        scene=scene,
        position=rest[6:8],
        yaw=rest[9],
        pitch=rest[10],
        collided=jnp.bool_(False),
        last_action=rest[11].astype(jnp.int32),
        held=jnp.int32(-1),
    )


class Rerendered(nn.Module):
    """An encoder of frames that are rendered when it is called.

    Attributes:
      sensors: cameras, by the names under which the encoder reads their frames.
      encoder: module from named observations [..., …] to features [..., F].
      viewpoint: name of the `ViewpointSensor`'s reading.
    """

    sensors: Mapping[str, Sensor]
    encoder: nn.Module
    viewpoint: str = "viewpoint"

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array]) -> jax.Array:
        """Returns float32 [..., F]."""
        viewpoint = observation[self.viewpoint]
        lead = viewpoint.shape[:-1]

        def render(viewpoint: jax.Array) -> dict[str, jax.Array]:
            state = state_at(viewpoint)
            return {name: sensor.observe(state, None) for name, sensor in self.sensors.items()}

        frames = jax.vmap(render)(viewpoint.reshape(-1, viewpoint.shape[-1]))
        frames = jax.tree.map(lambda x: x.reshape(*lead, *x.shape[1:]), frames)
        read = {name: x for name, x in observation.items() if name != self.viewpoint}
        return self.encoder({**read, **jax.lax.stop_gradient(frames)})
