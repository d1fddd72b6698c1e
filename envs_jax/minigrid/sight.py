"""What can be seen from a cell of a plane of packed tiles: the square ahead, and the light in it.

Rows of a view count from far (0) to the viewer's own, who stands in the middle of the last one.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import heading, is_kind


def rows_ahead(plane: jax.Array, position: jax.Array, direction: jax.Array, size: int) -> jax.Array:
    """Returns the cells in view, light or dark, as uint8[vy, vx].

    A square is cut out of the plane in one piece and turned: a look-up cell by cell would cost
    several times as much.

    Args:
      plane: uint8[W, H], indexed [x, y]; on all sides at least size − 1 cells wider than where
        viewers stand.
      position: int32[2], the viewer's element of the plane.
      direction: int32 scalar, 0 right (+x), 1 down (+y), 2 left, 3 up.
      size: edge of the view in cells, odd.
    """
    corner = position + (heading(direction) - 1) * (size // 2)
    square = jax.lax.dynamic_slice(plane, corner, (size, size))
    turned = (square[::-1], square[::-1, ::-1].T, square[:, ::-1], square.T)
    return jax.lax.select_n(direction, *turned)


def in_sight(rows: jax.Array, own: jax.Array, opaque: int) -> jax.Array:
    """Returns the cells uint8[vy, vx] with those that light does not reach as `tiles.UNSEEN`.

    Args:
      rows: as from `rows_ahead`; at most 31 along each edge.
      own: uint8 scalar, the tile to show where the viewer stands.
      opaque: bit set of the types that cannot be seen through.
    """
    size = len(rows)
    bits = 1 << jnp.arange(size, dtype=jnp.int32)

    def look(lit: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        cells, vy = row
        clear = jnp.sum(jnp.where(is_kind(cells, opaque), 0, bits), dtype=jnp.int32)
        lit_beyond = _spread(lit, clear, size)
        seen = (lit | lit_beyond) & bits != 0
        here = (vy == size - 1) & (bits == 1 << size // 2)
        shown = jnp.where(here, own, cells)
        return lit_beyond, jnp.where(seen, shown, jnp.uint8(tiles.UNSEEN))

    # The rows are walked by a scan, away from the viewer: written out as elementwise code, XLA's
    # CPU backend would compute the near rows again for every cell of the far ones.
    start = jnp.int32(1 << size // 2)
    return jax.lax.scan(look, start, (rows, jnp.arange(size, dtype=jnp.int32)), reverse=True)[1]


def _spread(lit: jax.Array, clear: jax.Array, size: int) -> jax.Array:
    """Returns how light goes on from one row of the view, as bits (bit vx) of an int32.

    Light spreads sideways from the lit cells through runs of clear ones. Each cell that it leaves
    shows itself and both its neighbours, in this row and in the next one beyond.

    Args:
      lit: which cells of the row light has reached from the row before.
      clear: which cells of the row can be seen through.
      size: the row's length.
    """
    left = right = lit & clear
    left_run = right_run = clear
    distance = 1
    while distance < size:  # Each round doubles how far light has gone along a run.
        left |= left_run & (left << distance)
        right |= right_run & (right >> distance)
        left_run &= left_run << distance
        right_run &= right_run >> distance
        distance *= 2
    flood = left | right
    return (flood | flood << 1 | flood >> 1) & ((1 << size) - 1)
