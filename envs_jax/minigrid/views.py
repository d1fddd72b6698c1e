"""The images of a grid world that an agent may be given, by name: codes or pixels, part or all.

The agent's own view in codes, MiniGrid's default, is in `sensors`; here is what MiniGrid has
wrappers for.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.rendering import render, render_egocentric
from envs_jax.minigrid.sensors import VIEW_SIZE, GridSensor, ImageSensor, PackedImageSensor
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import PyTree
from jaxact.spaces import Box

# Pixels of a cell's edge in observations, as in MiniGrid's wrappers; frames for people have more.
TILE_SIZE = 8


@dataclass(frozen=True)
class FullImageSensor(GridSensor):
    """The whole grid in MiniGrid's encoding, uint8[width, height, 3], indexed [x, y, channel].

    The agent's cell is (10, 0, direction), whatever else is in it.

    Source: `FullyObsWrapper` of minigrid 3.2.0.
    """

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the image."""
        return Box(0, 255, (self.width, self.height, 3), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the image."""
        del task_state
        agent = jnp.array([tiles.AGENT, tiles.RED, 0], jnp.uint8)
        agent = agent.at[2].set(state.direction.astype(jnp.uint8))
        image = tiles.decode(state.tiles[PADDING:-PADDING, PADDING:-PADDING])
        return image.at[state.position[0], state.position[1]].set(agent)


@dataclass(frozen=True)
class PixelSensor(GridSensor):
    """What sensors of pixels share: `tile_size` pixels for the edge of a cell."""

    tile_size: int = TILE_SIZE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.tile_size, int) or self.tile_size < 1:
            raise JaxactError(f"tile_size must be an int of at least 1; got {self.tile_size!r}")


@dataclass(frozen=True)
class RGBImageSensor(PixelSensor):
    """The agent's view in pixels, uint8[view_size · tile_size, view_size · tile_size, 3].

    Source: `RGBImgPartialObsWrapper` of minigrid 3.2.0.
    """

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the image."""
        edge = self.view_size * self.tile_size
        return Box(0, 255, (edge, edge, 3), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the image."""
        return render_egocentric(self.view.observe(state, task_state), self.tile_size)


@dataclass(frozen=True)
class RGBFullImageSensor(PixelSensor):
    """The whole grid in pixels, uint8[height · tile_size, width · tile_size, 3].

    What the agent sees, in a view of `view_size` cells, is drawn lighter.

    Source: `RGBImgObsWrapper` of minigrid 3.2.0.
    """

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the image."""
        return Box(0, 255, (self.height * self.tile_size, self.width * self.tile_size, 3), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the image."""
        del task_state
        return render(
            state,
            self.width,
            self.height,
            self.tile_size,
            see_through_walls=self.see_through_walls,
            view_size=self.view_size,
        )


_CODES: dict[str, type[GridSensor]] = {
    "image": ImageSensor,
    "packed": PackedImageSensor,
    "full": FullImageSensor,
}
_PIXELS: dict[str, type[PixelSensor]] = {"rgb": RGBImageSensor, "rgb_full": RGBFullImageSensor}


def image_sensor(
    observation: str,
    width: int,
    height: int,
    *,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
    tile_size: int = TILE_SIZE,
) -> GridSensor:
    """Returns the sensor of an image.

    Args:
      observation: what the image shows: `image`, the agent's view in MiniGrid's encoding; `packed`,
        the same with one byte a cell; `full`, the whole grid in MiniGrid's encoding; `rgb`, the
        agent's view in pixels; `rgb_full`, the whole grid in pixels.
      width: cells of the grid along x.
      height: cells of the grid along y.
      see_through_walls: whether walls and shut doors hide nothing.
      view_size: edge of the agent's view in cells, odd, from 3 to 31.
      tile_size: pixels of a cell's edge, where there are pixels.

    Raises:
      JaxactError: no such observation, or a size that cannot be.
    """
    if observation in _PIXELS:
        return _PIXELS[observation](width, height, view_size, see_through_walls, tile_size)
    if observation in _CODES:
        return _CODES[observation](width, height, view_size, see_through_walls)
    raise unknown("observation", str(observation), [*_CODES, *_PIXELS])
