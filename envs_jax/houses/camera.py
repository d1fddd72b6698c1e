"""A pinhole camera, where it is, and its rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.state import Body, HouseState
from jaxact.errors import JaxactError


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rays:
    """One ray through the middle of each pixel, in axes that turn with the yaw but not the pitch.

    A ray's direction (x, y, z) is not of length 1: it goes one metre along the camera's axis, so
    that multiples of it are depths. As x differs between columns only, y and z between rows only,
    these are all there is to store.

    Attributes:
      x: float32 [W], to the right.
      y: float32 [H], up.
      z: float32 [H], forward.
    """

    x: jax.Array
    y: jax.Array
    z: jax.Array

    @property
    def lengths(self) -> jax.Array:
        """Float32 [H, W]: range is depth times this."""
        squared = self.x**2 + (self.y**2 + self.z**2)[:, None]
        return jnp.sqrt(squared)


@dataclass(frozen=True)
class Camera:
    """What a camera takes in.

    Attributes:
      height: pixels.
      width: pixels.
      vertical_fov: degrees between the picture's upper and lower edge (AI2-THOR's field of view).
      horizontal_fov: degrees between its left and right edge; None for square pixels. Pictures that
        were squeezed into another shape have pixels that are not square.
      near: metres of depth before which nothing is seen.
    """

    numbers_are_structure: ClassVar[bool] = True

    height: int
    width: int
    vertical_fov: float = 60.0
    horizontal_fov: float | None = None
    near: float = 0.01

    def __post_init__(self) -> None:
        if min(self.height, self.width) < 1:
            raise JaxactError(
                f"a camera needs at least one pixel each way; got {self.height} × {self.width}"
            )
        for degrees in (self.vertical_fov, self.horizontal_fov or self.vertical_fov):
            if not 0 < degrees < 180:
                raise JaxactError(f"a field of view must be between 0 and 180; got {degrees!r}")
        if not self.near > 0:
            raise JaxactError(f"near must be positive; got {self.near!r}")

    @property
    def extent(self) -> tuple[float, float]:
        """How far the picture reaches up and to the right of its centre, one metre away."""
        up = math.tan(math.radians(self.vertical_fov) / 2)
        if self.horizontal_fov is None:
            return up, up * self.width / self.height
        return up, math.tan(math.radians(self.horizontal_fov) / 2)

    def rays(self, pitch: jax.Array) -> Rays:
        """Returns the rays when it looks down by `pitch` degrees; the top row comes first."""
        up_extent, right_extent = self.extent
        up = jnp.asarray(-up_extent * _centers(self.height), jnp.float32)
        right = jnp.asarray(right_extent * _centers(self.width), jnp.float32)
        turned = jnp.deg2rad(pitch)
        cosine, sine = jnp.cos(turned), jnp.sin(turned)
        return Rays(x=right, y=up * cosine - sine, z=up * sine + cosine)

    def finer(self, factor: int) -> Camera:
        """Returns the camera with `factor` times the pixels each way."""
        return replace(self, height=self.height * factor, width=self.width * factor)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pose:
    """Where a camera is and where it looks.

    Attributes:
      position: float32 [3], metres.
      yaw: float32 scalar, degrees clockwise from +z seen from above.
      pitch: float32 scalar, degrees that it looks down.
    """

    position: jax.Array
    yaw: jax.Array
    pitch: jax.Array


def eye(state: HouseState, body: Body) -> Pose:
    """Returns where an agent's camera is."""
    height = jnp.float32(body.camera_height)
    position = jnp.stack([state.position[0], height, state.position[1]])
    return Pose(position, state.yaw, state.pitch)


def _centers(pixels: int) -> np.ndarray:
    """Returns float64 [pixels], the pixels' centres in (−1, 1)."""
    return (2 * np.arange(pixels) + 1) / pixels - 1
