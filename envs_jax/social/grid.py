"""Cells, moves and free places of a square grid. A cell is int32 [2]: column and row."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

MOVES = ("left", "down", "right", "up")
# What each move adds to a cell; rows count downwards.
_DELTAS = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]], np.int32)


def move(cells: jax.Array, action: jax.Array, size: int) -> jax.Array:
    """Moves cells int32 [..., 2] by actions int32 [...]; at the rim they stay."""
    return jnp.clip(cells + jnp.asarray(_DELTAS)[action], 0, size - 1)


def legal(cell: jax.Array, size: int) -> jax.Array:
    """Returns which moves do not lead out of the grid, bool [4]."""
    after = cell + jnp.asarray(_DELTAS)
    return jnp.all((after >= 0) & (after < size), axis=-1)


def choose(key: jax.Array, allowed: jax.Array) -> jax.Array:
    """Draws one of those that are allowed, bool [n], each as likely; int32 scalar."""
    chances = jax.random.uniform(key, allowed.shape, jnp.float32)
    return jnp.argmax(jnp.where(allowed, chances, -1.0)).astype(jnp.int32)


def occupied(cells: jax.Array, size: int) -> jax.Array:
    """Returns where any of the cells int32 [n, 2] is, bool [size · size], row by row."""
    index = cells[:, 1] * size + cells[:, 0]
    return jnp.any(index[:, None] == jnp.arange(size * size, dtype=jnp.int32), axis=0)


def free_cell(key: jax.Array, taken: jax.Array, size: int) -> jax.Array:
    """Draws a cell that is not taken, bool [size · size], each as likely; any, if all are."""
    index = choose(key, ~taken)
    return jnp.stack([index % size, index // size])


def footprint(corner: jax.Array, side: int) -> jax.Array:
    """Returns the cells int32 [side², 2] of a square with this upper left corner."""
    offsets = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    return corner + jnp.asarray(offsets, jnp.int32)


def corners(agents: int, size: int) -> jax.Array:
    """Returns where agents begin, int32 [agents, 2]: the corners in turn, upper left first."""
    far = size - 1
    places = np.array([[0, 0], [far, 0], [0, far], [far, far]], np.int32)
    return jnp.asarray(places[np.arange(agents) % 4])


def planes(cells: list[jax.Array], size: int) -> jax.Array:
    """Draws lists of cells int32 [n, 2] as planes uint8 [size, size, len(cells)]."""
    return jnp.stack([occupied(c, size).reshape(size, size) for c in cells], -1).astype(jnp.uint8)
