"""Whether episodes can begin in written rooms; on the host, before anything compiles."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from envs_jax.furniture.footprints import DRESSER, NEAR, RADIUS, TELEVISION
from envs_jax.furniture.rooms import DrawnRooms, WrittenRooms
from jaxact.errors import JaxactError


def check_carrying(rooms: DrawnRooms | WrittenRooms) -> None:
    """Refuses written rooms in which some of FurnMove's episodes could not begin.

    Raises:
      JaxactError: two cannot hold the television anywhere, or where they can the dresser has no
        place left.
    """
    for what, floor, air in _written(rooms):
        dressers = np.argwhere(_fits(DRESSER, floor))
        # More than two carriers and the television's middle can be in the way of.
        enough = len(dressers) > 2 * DRESSER.shape[0] * DRESSER.shape[1] + 4 * 5
        held = np.argwhere(_fits(TELEVISION, air) & floor)
        sound = ((*pose, cells) for pose in held if len(cells := _around(floor, pose)) > 1)
        poses = list(islice(sound, 1 if enough else None))
        if not poses:
            raise JaxactError(
                f"{what} has nowhere that two can hold the television: it needs 13 cells without a "
                "wall, its middle over the floor, and two cells of floor within 3 of it"
            )
        if enough:
            continue
        covered = np.zeros((len(dressers), floor.size), bool)
        for i, (yaw, *middle) in enumerate(dressers):
            row, column = (np.array(middle) + DRESSER[yaw]).T
            covered[i, row * len(floor) + column] = True
        for _, row, column, around in poses:
            far = np.abs(dressers[:, 1:] - (row, column)).sum(-1) > 1
            clear = ~covered[far][:, around[:, 0] * len(floor) + around[:, 1]]
            left = clear.T.astype(np.int32) @ clear.astype(np.int32)
            np.fill_diagonal(left, 1)
            if not left.all():
                first, second = around[np.argwhere(left == 0)[0]].tolist()
                raise JaxactError(
                    f"{what} has no place for the dresser, 3 by 5 cells of floor, when the "
                    f"television is held over {[int(row), int(column)]} from {first} and {second}"
                )


def check_lifting(rooms: DrawnRooms | WrittenRooms, sight: int, apart: int) -> None:
    """Refuses written rooms in which FurnLift's television could be lifted nowhere.

    Args:
      rooms: any.
      sight: cells within which it is seen.
      apart: cells (Manhattan) that agents must be apart.

    Raises:
      JaxactError: it fits nowhere, or nowhere that two can stand around it.
    """
    for what, floor, air in _written(rooms):
        stands = np.argwhere(floor)
        for yaw, *middle in np.argwhere(_fits(TELEVISION, air)):
            under = (stands[:, None] == np.array(middle) + TELEVISION[yaw]).all(-1).any(-1)
            offsets = (stands - middle)[~under]
            offsets = offsets[(offsets**2).sum(-1) <= sight**2]
            # The greatest Manhattan distance is the greater of the spreads along the diagonals.
            diagonals = (offsets.sum(-1), offsets[:, 0] - offsets[:, 1])
            if len(offsets) and max(np.ptp(along) for along in diagonals) >= apart:
                break
        else:
            raise JaxactError(
                f"{what} has nowhere that two can lift the television: it needs 13 cells without a "
                f"wall, and two cells of floor within {sight} of its middle, {apart} or more apart"
            )


def _written(rooms: DrawnRooms | WrittenRooms) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields what each written room is called, its floor and its air, bool [S, S]."""
    if isinstance(rooms, WrittenRooms):
        for i, (rows, floor, air) in enumerate(zip(rooms.maps, *rooms.planes, strict=True)):
            yield f"maps[{i}], a room of {len(rows)} by {len(rows[0])} cells,", floor, air


def _fits(shape: np.ndarray, free: np.ndarray) -> np.ndarray:
    """As `footprints.places`, in NumPy."""
    size = len(free)
    padded = np.pad(free, RADIUS)
    corners = RADIUS + shape
    return np.stack(
        [
            np.all([padded[r : r + size, c : c + size] for r, c in cells.tolist()], axis=0)
            for cells in corners
        ]
    )


def _around(floor: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Returns the cells of floor [n, 2] from which a television is held, by yaw, row and column."""
    cells = pose[1:] + np.argwhere(NEAR[pose[0]]) - RADIUS
    cells = cells[((cells >= 0) & (cells < len(floor))).all(-1)]
    return cells[floor[cells[:, 0], cells[:, 1]]]
