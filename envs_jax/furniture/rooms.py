"""Rooms: drawn at random, or from maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.furniture.footprints import CELL
from envs_jax.houses.importers.reading import LARGEST, read_array
from jaxact.errors import JaxactError

# In written maps: where agents can stand; what only furniture that is carried passes over; neither.
FLOOR, LOW, WALL = ".", "o", "#"

_PIECES = 8
_TALL = 0.3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Room:
    """What stands in the way; bool [S, S] each.

    Attributes:
      floor: where an agent can have its middle.
      air: what a carried object may cover; all of the floor, and what is low.
    """

    floor: jax.Array
    air: jax.Array


@dataclass(frozen=True)
class DrawnRooms:
    """Rooms as living rooms are: furniture along the walls, and maybe a table in the middle.

    What is drawn in them is not checked to be possible: of 4,000 of FurnMove's episodes all but 2
    had a joint plan from start to goal, however long.

    Attributes:
      size: S, cells along each edge of the map.
      smallest: cells along the shortest edge of a room; the longest has S − 2.
    """

    size: int = 24
    smallest: int = 14

    def __post_init__(self) -> None:
        if not 10 <= self.smallest <= self.size - 2:
            raise JaxactError(
                f"rooms must have edges of 10 to {self.size - 2} cells on a map of {self.size}, "
                f"and the smallest is given as {self.smallest}"
            )

    def sample(self, key: jax.Array) -> Room:
        """Draws a room."""
        edges_key, pieces_key, table_key = jax.random.split(key, 3)
        edges = jax.random.randint(edges_key, (2,), self.smallest, self.size - 1, jnp.int32)
        rows, columns = jnp.meshgrid(*[jnp.arange(self.size, dtype=jnp.int32)] * 2, indexing="ij")
        inside = (rows >= 1) & (rows <= edges[0]) & (columns >= 1) & (columns <= edges[1])

        def piece(key: jax.Array) -> tuple[jax.Array, jax.Array]:
            keys = jax.random.split(key, 5)
            wall = jax.random.randint(keys[0], (), 0, 4, jnp.int32)
            length = jax.random.randint(keys[1], (), 2, 6, jnp.int32)
            depth = jax.random.randint(keys[2], (), 1, 4, jnp.int32)
            height, width = edges[0], edges[1]
            away = jnp.stack([rows - 1, width - columns, height - rows, columns - 1])[wall]
            along = jnp.stack([columns, rows, columns, rows])[wall]
            room = jnp.where(wall % 2 == 0, width, height) - length
            start = 1 + jnp.floor(
                jax.random.uniform(keys[3], (), jnp.float32) * (room + 1).astype(jnp.float32)
            ).astype(jnp.int32)
            cells = (away < depth) & (along >= start) & (along < start + length)
            return cells, jax.random.uniform(keys[4], (), jnp.float32) < _TALL

        pieces, tall = jax.vmap(piece)(jax.random.split(pieces_key, _PIECES))
        keys = jax.random.split(table_key, 3)
        half = jax.random.randint(keys[0], (2,), 0, 3, jnp.int32)
        shift = jax.random.randint(keys[1], (2,), -2, 3, jnp.int32)
        middle = (edges + 1) // 2 + shift
        stands = jax.random.uniform(keys[2], (), jnp.float32) < 0.5
        table = (
            stands
            & (jnp.abs(rows - middle[0]) <= half[0])
            & (jnp.abs(columns - middle[1]) <= half[1])
        )
        blocked = jnp.any(pieces, axis=0) | table
        return Room(
            floor=inside & ~blocked,
            air=inside & ~jnp.any(pieces & tall[:, None, None], axis=0),
        )


@dataclass(frozen=True)
class WrittenRooms:
    """Rooms from maps, each as likely.

    Attributes:
      maps: each a tuple of rows, of "." (floor), "o" (low furniture) and "#" (neither).
      size: S, cells along each edge of the map that they are put on; at least that of the largest.
    """

    maps: tuple[tuple[str, ...], ...]
    size: int

    def __post_init__(self) -> None:
        if not self.maps:
            raise JaxactError("maps must have at least one room")
        for rows in self.maps:
            if not rows or {len(row) for row in rows} != {len(rows[0])}:
                raise JaxactError("a map's rows must be of one length, and at least one")
            unknown = set("".join(rows)) - {FLOOR, LOW, WALL}
            if unknown:
                raise JaxactError(
                    f"a map is written with {FLOOR!r}, {LOW!r} and {WALL!r}, not {min(unknown)!r}"
                )
            if max(len(rows), len(rows[0])) > self.size:
                raise JaxactError(
                    f"a map of {len(rows)} by {len(rows[0])} cells does not fit on {self.size}"
                )

    @property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """All rooms' floor and air, see `Room`, bool [N, S, S] each."""
        written = np.full((len(self.maps), self.size, self.size), WALL)
        for i, rows in enumerate(self.maps):
            written[i, : len(rows), : len(rows[0])] = [list(row) for row in rows]
        return written == FLOOR, written != WALL

    def sample(self, key: jax.Array) -> Room:
        """Draws a room."""
        floor, air = self.planes
        index = jax.random.randint(key, (), 0, len(self.maps), jnp.int32)
        return Room(jnp.asarray(floor)[index], jnp.asarray(air)[index])


def read_map(path: str | Path) -> tuple[str, ...]:
    """Reads the points float [n, 2] (x, z) that can be reached, as ALFRED's layouts have them.

    An agent's body has 0.2 m around its middle, so that there is room for what is carried a cell
    beyond the points too. Rows of the map go down with z.

    Args:
      path: a NumPy file of points of a grid of 0.25 m.

    Returns:
      The map, for `WrittenRooms`.

    Raises:
      JaxactError: the file holds no such points.
    """
    points = read_array(path)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points) or points.dtype.kind not in "fi":
        raise JaxactError(
            f"{path} must be points float [n, 2], not {points.dtype}{list(points.shape)}"
        )
    if not np.abs(points).max() <= LARGEST:
        raise JaxactError(f"{path} must be points no further than {LARGEST:g} m from the origin")
    steps = points / CELL
    if not np.abs(steps - np.round(steps)).max() <= 0.01:
        raise JaxactError(f"{path} must be points of a grid of {CELL} m")
    cells = np.round(steps).astype(np.int64)
    low, high = cells.min(axis=0), cells.max(axis=0)
    if (high - low).max() > 1000:
        raise JaxactError(f"{path} has points more than 1000 cells from each other")
    written = np.full((high - low)[::-1] + 3, WALL)
    row, column = high[1] - cells[:, 1] + 1, cells[:, 0] - low[0] + 1
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            written[row + i, column + j] = LOW
    written[row, column] = FLOOR
    return tuple("".join(line) for line in written)
