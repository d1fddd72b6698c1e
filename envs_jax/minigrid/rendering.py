"""Frames of grid worlds, pixel for pixel those of MiniGrid, made inside compiled programs.

A frame is put together from tile pictures (see `pictures`) by one gather, so these functions can
be jitted, vmapped over lanes and scanned over time.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.minigrid import pictures, tiles
from envs_jax.minigrid.sensors import VIEW_SIZE, PackedImageSensor
from envs_jax.minigrid.state import PADDING, GridState

TILE_SIZE = 32
# In its own view the agent looks up.
_UP = 3


def render(
    state: GridState,
    width: int,
    height: int,
    tile_size: int = TILE_SIZE,
    *,
    highlight: bool = True,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
) -> jax.Array:
    """Draws the whole grid from above.

    Args:
      state: one world.
      width: cells of the grid along x.
      height: cells of the grid along y.
      tile_size: pixels of a cell's edge.
      highlight: whether what the agent sees is drawn lighter.
      see_through_walls: whether the agent does.
      view_size: edge of the agent's view in cells, odd, from 3 to 31.

    Returns:
      uint8[height · tile_size, width · tile_size, 3], RGB; equal to `MiniGridEnv.get_full_render`
      of minigrid 3.2.0.

    Raises:
      JaxactError: the view size is none of these.
    """
    plane = state.tiles[PADDING:-PADDING, PADDING:-PADDING]
    x, y = state.position
    agent = jnp.zeros(plane.shape, jnp.int32).at[x, y].set(state.direction.astype(jnp.int32) + 1)
    seen = jnp.zeros(plane.shape, bool)
    if highlight:
        seen = PackedImageSensor(width, height, view_size, see_through_walls).visible(state)
    return _compose(plane, agent, seen, tile_size)


def render_egocentric(view: jax.Array, tile_size: int = TILE_SIZE) -> jax.Array:
    """Draws the agent's own view, the agent in the middle of the lowest row, looking up.

    Args:
      view: an observation, either MiniGrid's image uint8[V, V, 3] or packed tiles uint8[V, V].
      tile_size: pixels of a cell's edge.

    Returns:
      uint8[V · tile_size, V · tile_size, 3], RGB; equal to `MiniGridEnv.get_pov_render` of
      minigrid 3.2.0. Cells out of sight are empty and dark.
    """
    codes = view if view.ndim == 2 else _packed(view)
    size = len(codes)
    agent = jnp.zeros(codes.shape, jnp.int32).at[size // 2, size - 1].set(_UP + 1)
    return _compose(codes, agent, codes != tiles.UNSEEN, tile_size)


def _packed(image: jax.Array) -> jax.Array:
    """Turns MiniGrid's encoding uint8[..., 3] into packed tiles uint8[...]."""
    kind, color, status = image[..., 0], image[..., 1], image[..., 2]
    is_door = kind == tiles.OPEN_DOOR
    kind = jnp.where(is_door & (status == 1), jnp.uint8(tiles.CLOSED_DOOR), kind)
    kind = jnp.where(is_door & (status == 2), jnp.uint8(tiles.LOCKED_DOOR), kind)
    return kind | color << tiles.COLOR_SHIFT


def _compose(codes: jax.Array, agent: jax.Array, seen: jax.Array, tile_size: int) -> jax.Array:
    """Lays out pictures: tiles uint8[W, H], agents int32[W, H] and highlights bool[W, H]."""
    kind = (codes & tiles.TYPE_MASK).astype(jnp.int32)
    color = (codes >> tiles.COLOR_SHIFT).astype(jnp.int32)
    picture = (kind * tiles.NUM_COLORS + color) * pictures.NUM_AGENTS + agent
    picture = picture * 2 + seen.astype(jnp.int32)
    frame = jnp.asarray(pictures.atlas(tile_size))[picture.T]
    height, width = picture.T.shape
    return frame.swapaxes(1, 2).reshape(height * tile_size, width * tile_size, 3)
