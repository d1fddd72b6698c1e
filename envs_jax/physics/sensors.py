"""What a body in a physics world senses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Box


@dataclass(frozen=True)
class JointSensor(Sensor):
    """All joints' positions, and then their velocities, float32.

    Attributes:
      world: whose joints they are.
      skip: how many of the first positions are left out, such as how far one has come.
      fastest: velocities are clipped to ± this.
      on_circle: positions are angles, and are given as all their cosines and then all their sines:
        for joints that turn without end, of which a full turn is none.
    """

    world: Physics
    skip: int = 0
    fastest: float = math.inf
    on_circle: bool = False

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        model = self.world.model
        positions = model.nq - self.skip
        return Box(-math.inf, math.inf, (positions * (1 + self.on_circle) + model.nv,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        bound = jnp.float32(self.fastest)
        velocity = jnp.clip(state.velocity, -bound, bound)
        position = state.position[self.skip :]
        if self.on_circle:
            position = jnp.concatenate([jnp.cos(position), jnp.sin(position)])
        return jnp.concatenate([position, velocity])


@dataclass(frozen=True)
class BodySensor(Sensor):
    """Where a body is and how it is turned, float32 [7]: x, y, z and a quaternion w, x, y, z.

    Attributes:
      world: which has it.
      body: its name.
    """

    world: Physics
    body: str

    def __post_init__(self) -> None:
        self.world.index("body", self.body)

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (7,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        row = self.world.index("body", self.body)
        return jnp.concatenate([state.body_position[row], state.body_rotation[row]])


@dataclass(frozen=True)
class ModelSensor(Sensor):
    """A sensor of the model itself: touch, accelerometer, gyro, rangefinder and so on, float32.

    Attributes:
      world: which has it.
      name: its name in the model.
    """

    world: Physics
    name: str

    def __post_init__(self) -> None:
        self.world.index("sensor", self.name)

    @property
    def space(self) -> Box:
        """As many numbers as MuJoCo says."""
        sensor = self.world.model.sensor(self.name)
        return Box(-math.inf, math.inf, (int(sensor.dim[0]),))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        sensor = self.world.model.sensor(self.name)
        first = int(sensor.adr[0])
        return state.readings[first : first + int(sensor.dim[0])]
