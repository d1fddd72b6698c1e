"""Cells, moves and free places of a square grid. A cell is int32 [2]: column and row."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

MOVES = ("left", "down", "right", "up")
# What each move adds to a cell; rows count downwards.
_DELTAS = np.array([[-1, 0], [0, 1], [1, 0], [0, -1]], np.int32)
# Places that are counted at once.
_ROW = 32


def move(cells: jax.Array, action: jax.Array, size: int) -> jax.Array:
    """Moves cells int32 [..., 2] by actions int32 [...]; at the rim they stay."""
    return jnp.clip(cells + jnp.asarray(_DELTAS)[action], 0, size - 1)


def legal(cell: jax.Array, size: int) -> jax.Array:
    """Returns which moves do not lead out of the grid, bool [4]."""
    after = cell + jnp.asarray(_DELTAS)
    return jnp.all((after >= 0) & (after < size), axis=-1)


def draws(key: jax.Array, count: int) -> jax.Array:
    """Returns float32 [count], uniform in [0, 1): what the functions below choose by."""
    return jax.random.uniform(key, (count,), jnp.float32)


def choose(draw: jax.Array, allowed: jax.Array) -> jax.Array:
    """Returns one of those that are allowed, bool [n], each as likely; 0 if none is; int32.

    Args:
      draw: uniform in [0, 1).
      allowed: bool [n].
    """
    if allowed.shape[0] <= 2 * _ROW:
        upto = _running_count(allowed)
        return jnp.sum(upto <= _rank(draw, upto[-1]), dtype=jnp.int32)
    # The row of it is found first, so that many cells cost in proportion.
    rows = jnp.pad(allowed, (0, -allowed.shape[0] % _ROW)).reshape(-1, _ROW)
    held = jnp.sum(rows, axis=1, dtype=jnp.int32)
    upto = _running_count(held)
    rank = _rank(draw, upto[-1])
    row = jnp.sum(upto <= rank, dtype=jnp.int32)
    before = upto[row] - held[row]
    return _ROW * row + jnp.sum(_running_count(rows[row]) <= rank - before, dtype=jnp.int32)


def _running_count(values: jax.Array) -> jax.Array:
    """Returns the sums of values [n] up to each, int32 [n]; they must be at most 256."""
    # On processors a product with a triangle costs less than a running sum, which XLA splits into
    # many steps; it is exact at any precision of products, as factors have eight bits at most.
    upto = np.triu(np.ones((values.shape[0],) * 2, np.float32))
    return (values.astype(jnp.float32) @ jnp.asarray(upto)).astype(jnp.int32)


def _rank(draw: jax.Array, count: jax.Array) -> jax.Array:
    """Returns which of so many is chosen, −1 if there are none."""
    # The product may round up to the count.
    return jnp.minimum((draw * count.astype(jnp.float32)).astype(jnp.int32), count - 1)


def occupied(cells: jax.Array, size: int) -> jax.Array:
    """Returns where any of the cells int32 [n, 2] is, bool [size · size], row by row."""
    index = cells[:, 1] * size + cells[:, 0]
    return jnp.any(index[:, None] == jnp.arange(size * size, dtype=jnp.int32), axis=0)


def free_cell(draw: jax.Array, taken: jax.Array, size: int) -> jax.Array:
    """Returns a cell that is not taken, bool [size · size], each as likely; the first, if all are.

    Args:
      draw: uniform in [0, 1).
      taken: bool [size · size], row by row.
      size: cells along each edge.
    """
    index = choose(draw, ~taken)
    return jnp.stack([index % size, index // size])


def free_cells(draws: jax.Array, taken: jax.Array, size: int) -> jax.Array:
    """Returns different cells that are not taken, int32 [n, 2], by `draws` [n]."""
    cells = []
    for draw in draws:
        cells.append(free_cell(draw, taken, size))
        taken = taken | occupied(cells[-1][None], size)
    return jnp.stack(cells)


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
