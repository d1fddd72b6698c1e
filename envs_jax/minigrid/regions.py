"""Sets of cells as bitboards word[H] (see `planner`): neighbours, regions, safe places."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax

from envs_jax.minigrid.planner import Board
from jaxact.compaction import together

# Steps of growth between two looks at whether there was any.
_CHUNK = 4


def cell_board(cell: jax.Array, like: Board) -> Board:
    """Returns the board with the one cell (x, y), int32[2]; as many rows and bits as `like`."""
    rows = jnp.arange(len(like), dtype=jnp.int32) == cell[1]
    return jnp.where(rows, jnp.ones((), like.dtype) << cell[0].astype(like.dtype), _none(like))


def beside(cells: Board) -> Board:
    """Returns the cells that share an edge with one of `cells`."""
    return cells >> 1 | cells << 1 | _down(cells) | _up(cells)


def around(cells: Board) -> Board:
    """Returns `cells` and all that share an edge or a corner with one of them."""
    wide = cells | cells >> 1 | cells << 1
    return wide | _down(wide) | _up(wide)


@together
def spread(seeds: Board, passable: Board) -> Board:
    """Grows `seeds` through passable cells."""
    return _spread(seeds.T, passable.T).T


@together
def nearest(seeds: Board, passable: Board, obstacles: Board, sought: Board) -> Board:
    """Returns the obstacles among `sought` with the fewest other obstacles between them and seeds.

    The fewest, not the nearest in cells: moving something away from the side of a row of
    obstacles, where another one can be passed at once, could go on for ever.
    """
    passable, obstacles, sought = passable.T, obstacles.T, sought.T

    def grow(carry: tuple[Board, jax.Array]) -> tuple[Board, jax.Array]:
        now, grows = carry
        region = _spread(jnp.where(grows, now, _none(now)), passable)
        grown = jnp.where(grows, region | beside(region) & obstacles, now)
        found = jnp.any(grown & obstacles & sought != 0, axis=0)
        return grown, jnp.any(grown != now, axis=0) & ~found

    def some_grow(carry: tuple[Board, jax.Array]) -> jax.Array:
        return jnp.any(carry[1])

    start = seeds.T
    begin = (start, jnp.any(start != 0, axis=0) & ~jnp.any(start & obstacles & sought != 0, axis=0))
    reached, _ = lax.while_loop(some_grow, grow, begin)
    return (reached & obstacles & sought).T


def _spread(seeds: Board, passable: Board) -> Board:
    """Grows seeds word[H, N] of N lanes: with lanes last, the inner loops run along them."""

    def grow(_: int, now: Board) -> Board:
        return now | beside(now) & passable

    def chunk(carry: tuple[Board, jax.Array]) -> tuple[Board, jax.Array]:
        before, _ = carry
        now = lax.fori_loop(0, _CHUNK, grow, before)
        return now, jnp.any(now != before)

    def grows(carry: tuple[Board, jax.Array]) -> jax.Array:
        return carry[1]

    return lax.while_loop(grows, chunk, (seeds, jnp.any(seeds != 0)))[0]


def first_cell(cells: Board) -> jax.Array:
    """Returns (x, y), int32[2], of one of `cells`; meaningless if there is none."""
    y = jnp.argmax(cells != 0).astype(jnp.int32)
    row = cells[y]
    below = (row & (~row + 1)) - 1
    return jnp.stack([lax.population_count(below).astype(jnp.int32), y])


def dispensable(passable: Board) -> Board:
    """Returns the cells that can be blocked without cutting their neighbours off from each other.

    Going round a cell, its passable neighbours form runs; with no more than one that has a cell
    sharing an edge with it, the ways through it have a way round it.
    """
    north, south = _down(passable), _up(passable)
    ring = [
        north,
        north >> 1,
        passable >> 1,
        south >> 1,
        south,
        south << 1,
        passable << 1,
        north << 1,
    ]
    one = several = jnp.zeros_like(passable)
    for side in range(0, 8, 2):
        ends = ring[side] & ~(ring[side + 1] & ring[(side + 2) % 8])
        one, several = one | ends, several | (one & ends)
    return ~several


def _none(like: Board) -> jax.Array:
    return jnp.zeros((), like.dtype)


def _down(cells: Board) -> Board:
    return lax.pad(cells, _none(cells), [(1, -1, 0), *[(0, 0, 0)] * (cells.ndim - 1)])


def _up(cells: Board) -> Board:
    return lax.pad(cells, _none(cells), [(-1, 1, 0), *[(0, 0, 0)] * (cells.ndim - 1)])
