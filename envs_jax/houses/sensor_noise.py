"""How cameras err: noise of colours and of depths.

A sensor is given the state and no key, so its noise is drawn from a key that is made of the state:
same pose after the same action, same noise. An agent that cannot move on sees a still picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.state import HouseState
from jaxact.errors import JaxactError

# The Redwood model's camera: a table of 80 × 80 places and 5 depths, for pictures of 640 × 480.
_TABLE = (80, 80, 5)
_TABLE_STEP = np.array([480 / 80, 640 / 80], np.int32)
_TABLE_PIXELS = np.array([479, 639], np.float32)
# Baseline times focal length (metres times pixels), the steps disparity is measured in, and its
# standard deviation; that of the pixel that is read, in pixels; and where measuring ends.
_DISPARITY, _STEPS, _DEVIATION = np.float32(35.130), np.float32(8), np.float32(0.027778)
_STRAY, _FARTHEST = np.float32(0.25), np.float32(10)


@dataclass(frozen=True)
class GaussianNoise:
    """Independent normal noise on every channel of an RGB picture.

    Attributes:
      intensity: its standard deviation, of colours in [0, 1].

    Source: `GaussianNoiseModel` of habitat-sim.
    """

    intensity: float = 0.2

    def apply(self, key: jax.Array, picture: jax.Array) -> jax.Array:
        """Returns a picture uint8 [H, W, 3] with noise."""
        noise = self.intensity * jax.random.normal(key, picture.shape, jnp.float32)
        noisy = picture.astype(jnp.float32) / 255 + noise
        return (jnp.clip(noisy, 0, 1) * 255).astype(jnp.uint8)


@dataclass(frozen=True)
class DisparityNoise:
    """Depth as a structured-light camera measures it: by disparity, in steps, from strayed pixels.

    From 10 metres on, and where measuring fails, depth is 0.

    Attributes:
      table: a `.npy` file of the camera's distortion, float [80, 400], as habitat-sim ships it for
        the Redwood model (`redwood-depth-dist-model.npy`); None for no distortion.
      multiplier: of the standard deviations.

    Source: `RedwoodDepthNoiseModel` of habitat-sim, after Choi et al. 2015.
    """

    table: str | None = None
    multiplier: float = 1.0

    def apply(self, key: jax.Array, depth: jax.Array) -> jax.Array:
        """Returns depths float32 [H, W] in metres with noise.

        Raises:
          JaxactError: the table cannot be read, or is none.
        """
        draws = self.multiplier * jax.random.normal(key, (3, *depth.shape), jnp.float32)
        last = np.array(depth.shape, np.float32)[:, None, None] - 1
        places = jnp.asarray(np.indices(depth.shape), jnp.float32)
        strayed = jnp.clip(places + _STRAY * draws[:2], 0, last)
        y, x = (strayed + jnp.float32(0.5)).astype(jnp.int32)
        # One depth is measured for each 2 × 2 pixels.
        true = depth[y & ~1, x & ~1]
        in_reach = true < _FARTHEST
        true = jnp.where(in_reach, true, _FARTHEST)
        factor = jnp.ones_like(true)
        if self.table is not None:
            factor = _distortion(_read(self.table), jnp.stack([y, x]), last, true)
        disparity = _DISPARITY * factor / true + _DEVIATION * draws[2]
        steps = jnp.round(disparity * _STEPS)
        measured = in_reach & (factor >= jnp.float32(1e-5)) & (steps > 0)
        return jnp.where(measured, _DISPARITY * _STEPS / jnp.maximum(steps, 1), jnp.float32(0))


def noise_key(state: HouseState, stream: int) -> jax.Array:
    """Returns a key that depends on an agent's pose and last action, and on nothing else.

    Args:
      state: of the agent.
      stream: which sensor's noise; different numbers give independent draws.
    """
    pose = jnp.stack([*state.position, state.yaw, state.pitch]).astype(jnp.float32)
    words = jax.lax.bitcast_convert_type(pose, jnp.uint32)
    key = jax.random.key(stream, impl="philox2x32")
    for word in (*words, state.last_action.astype(jnp.uint32)):
        key = jax.random.fold_in(key, word)
    return key


def _distortion(
    table: np.ndarray, places: jax.Array, last: np.ndarray, depth: jax.Array
) -> jax.Array:
    """Returns by how much, float32 [H, W], depths are overestimated, between the table's depths.

    Args:
      table: float32 [80, 80, 5]; its depths are 1, 3, 5, 7 and 9 metres.
      places: int32 [2, H, W], row and column of the pixel that was read.
      last: [2, 1, 1], the last row and column.
      depth: float32 [H, W].
    """
    scale = _TABLE_PIXELS[:, None, None] / np.maximum(last, 1)
    pixel = (places.astype(jnp.float32) * scale + jnp.float32(0.5)).astype(jnp.int32)
    row, column = pixel // _TABLE_STEP[:, None, None]
    above = ((depth + 1) / 2).astype(jnp.int32)
    share = (depth - (2 * above - 1).astype(jnp.float32)) / 2
    values = jnp.asarray(table)
    lower = values[row, column, jnp.clip(above - 1, 0, 4)]
    upper = values[row, column, jnp.clip(above, 0, 4)]
    return (1 - share) * lower + share * upper


@lru_cache(maxsize=4)
def _read(path: str) -> np.ndarray:
    """Returns the table float32 [80, 80, 5] of a file."""
    if not Path(path).is_file():
        raise JaxactError(f"there is no depth distortion table {path}")
    table = np.load(path)
    if table.size != np.prod(_TABLE):
        raise JaxactError(f"a depth distortion table is [80, 400]; {path} is {list(table.shape)}")
    return table.astype(np.float32).reshape(_TABLE)
