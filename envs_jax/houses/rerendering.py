"""Frames that are not stored: the rollout keeps where the agent was, and the model looks again.

To compute a frame again is cheap beside what a network does with it. With `ViewpointSensor` in
place of camera sensors and `Rerendered` around the encoder, no frame is stored:

    sensors = {"viewpoint": ViewpointSensor(boxes=64), "point_goal": ...}
    encoder = Rerendered({"depth": DepthSensor(camera, body)}, Concatenated({...}))
"""

from __future__ import annotations

from collections.abc import Mapping

import flax.linen as nn
import jax

from envs_jax.houses.viewpoint import state_at
from jaxact.pomdp import Sensor


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
