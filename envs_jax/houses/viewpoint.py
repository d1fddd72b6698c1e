"""All that a camera's frame depends on, as one reading.

A frame is a function of the house and of the agent's pose. What a rollout holds of each step is
then a few kilobytes whatever the resolution, and the model renders frames again; see `rerendering`.
"""

from __future__ import annotations

from dataclasses import dataclass

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
