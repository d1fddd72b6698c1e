"""Where an agent is in a house, and the body it has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax

from envs_jax.houses.scene import Scene


@dataclass(frozen=True)
class Body:
    """A vertical cylinder on the floor with a camera.

    Attributes:
      radius: metres.
      height: metres; boxes that begin higher are no obstacle.
      camera_height: metres above the floor.
    """

    numbers_are_structure: ClassVar[bool] = True

    radius: float
    height: float
    camera_height: float


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HouseState:
    """A house and the agent in it.

    Attributes:
      scene: as it is now: what has been opened or carried is where it was left.
      position: float32 [2], the plan (x, z) of the cylinder's axis.
      yaw: float32 scalar, degrees in [0, 360), clockwise from +z seen from above.
      pitch: float32 scalar, degrees that the camera looks down (AI2-THOR's horizon).
      collided: bool scalar, whether the last action was stopped by something.
      last_action: int32 scalar, the number of actions before the first.
      held: int32 scalar, the row of the box that is carried; −1 if none.
    """

    scene: Scene
    position: jax.Array
    yaw: jax.Array
    pitch: jax.Array
    collided: jax.Array
    last_action: jax.Array
    held: jax.Array
