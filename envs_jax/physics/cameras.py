"""What the rover's camera sees: pictures as those of the houses, of its arena."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.houses.state import HouseState
from envs_jax.houses.vision import CameraSensor
from envs_jax.physics.environment import PhysicsState
from envs_jax.physics.rover import scene
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Space


@dataclass(frozen=True)
class RoverCamera(Sensor):
    """A house's camera on the rover, level and looking ahead from above its middle.

    Attributes:
      sensor: what is made of the picture: colours, depths, categories or instances.
    """

    sensor: CameraSensor

    @property
    def space(self) -> Space:
        """The sensor's."""
        return self.sensor.space

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        return self.sensor.observe(as_house(state), task_state)

    def picture(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading in colours, uint8 [H, W, 3]."""
        return self.sensor.picture(as_house(state), task_state)


def as_house(state: PhysicsState) -> HouseState:
    """Returns the arena as a house, and the rover as who is in it."""
    x, y, turned = state.position
    return HouseState(
        scene=scene(state),
        position=jnp.stack([x, y]),
        # There 0 is along the second axis, and it grows clockwise.
        yaw=jnp.mod(90.0 - jnp.rad2deg(turned), 360.0),
        pitch=jnp.float32(0),
        collided=jnp.bool_(False),
        last_action=jnp.int32(0),
        held=jnp.int32(-1),
    )
