"""Directions, and the cells that furniture covers.

A cell is int32 [2], row and column; rows count downwards. Yaws are int32 quarter turns clockwise,
0 looks up the map.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.social.grid import choose, draws

# Metres along each edge of a cell, as in iTHOR.
CELL = 0.25
# What a step in the direction of each yaw adds to a cell.
DIRECTIONS = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]], np.int32)
# Cells within which the carriers' middles must be of a cell of what they carry: 0.76 m.
REACH = 3

_TELEVISION = ((-1, (-1, 0, 1)), (0, (-2, -1, 0, 1, 2)), (1, (-2, -1, 0, 1, 2)))
# Half the edge of the square masks below.
RADIUS = 2 + REACH


def _turned(cells: np.ndarray) -> np.ndarray:
    """Returns cells [n, 2] around the middle at each of the four yaws, [4, n, 2]."""
    turns = [cells]
    for _ in range(3):
        turns.append(np.stack([turns[-1][:, 1], -turns[-1][:, 0]], axis=-1))
    return np.stack(turns).astype(np.int32)


# Cells that a television covers, and a dresser: int32 [4, 13, 2] and [4, 15, 2], by yaw and
# relative to its middle. They are CORDIAL-SYNC's.
TELEVISION = _turned(np.array([(row, c) for row, columns in _TELEVISION for c in columns]))
DRESSER = _turned(np.array([(row, c) for row in (-1, 0, 1) for c in range(-2, 3)]))


def _near() -> np.ndarray:
    offsets = np.stack(np.meshgrid(*[np.arange(-RADIUS, RADIUS + 1)] * 2, indexing="ij"), -1)
    masks = []
    for cells in TELEVISION:
        squares = ((offsets[:, :, None] - cells) ** 2).sum(-1).min(-1)
        masks.append((squares > 0) & (squares <= REACH**2))
    return np.stack(masks)


# Where carriers may stand, bool [4, 11, 11], by the television's yaw and around its middle: within
# reach of it, and not under it.
NEAR = _near()


def is_near(cell: jax.Array, middle: jax.Array, yaw: jax.Array) -> jax.Array:
    """Returns whether cells int32 [..., 2] are where a television's carriers may stand."""
    offset = cell - middle + RADIUS
    inside = jnp.all((offset >= 0) & (offset <= 2 * RADIUS), axis=-1)
    row, column = jnp.moveaxis(jnp.clip(offset, 0, 2 * RADIUS), -1, 0)
    return inside & jnp.asarray(NEAR)[yaw, row, column]


def covered(shape: np.ndarray, middle: jax.Array, yaw: jax.Array, size: int) -> jax.Array:
    """Returns the cells that furniture covers, bool [size, size].

    Args:
      shape: of the furniture, int32 [4, n, 2], such as `TELEVISION`.
      middle: its cell.
      yaw: how it is turned.
      size: of the map.
    """
    cells = middle + jnp.asarray(shape)[yaw]
    rows, columns = (cells[:, i, None] == jnp.arange(size, dtype=jnp.int32) for i in range(2))
    return jnp.any(rows[:, :, None] & columns[:, None, :], axis=0)


def places(shape: np.ndarray, free: jax.Array) -> jax.Array:
    """Returns where furniture can have its middle, bool [4, S, S] by yaw.

    Args:
      shape: of the furniture, int32 [4, n, 2].
      free: bool [S, S], cells that it may cover.
    """
    size = free.shape[0]
    padded = jnp.pad(free, RADIUS)
    fits = []
    for cells in shape:
        starts = RADIUS + cells
        views = [padded[r : r + size, c : c + size] for r, c in starts.tolist()]
        fits.append(jnp.all(jnp.stack(views), axis=0))
    return jnp.stack(fits)


def is_set(mask: jax.Array, cell: jax.Array) -> jax.Array:
    """Returns whether a cell is on the map [S, S] and set there."""
    on_map = jnp.all((cell >= 0) & (cell < mask.shape[0]))
    row, column = jnp.clip(cell, 0, mask.shape[0] - 1)
    return on_map & mask[row, column]


def at(cell: jax.Array, size: int) -> jax.Array:
    """Returns the map bool [size, size] with one cell set."""
    index = jnp.arange(size, dtype=jnp.int32)
    return (index == cell[0])[:, None] & (index == cell[1])


def choose_place(key: jax.Array, allowed: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Draws a yaw and a cell of those allowed, bool [n, S, S], each as likely."""
    size = allowed.shape[1]
    index = choose(draws(key, 1)[0], allowed.reshape(-1))
    return index // size**2, jnp.stack([index // size % size, index % size])
