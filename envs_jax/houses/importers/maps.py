"""Houses from maps: occupancy seen from above, and the points of a grid that can be reached."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.generator import COLORS
from envs_jax.houses.importers.reading import LARGEST, read_array
from envs_jax.houses.scene import Scene, make_scene
from jaxact.errors import JaxactError

_HEIGHT = 2.5
_MOST_CELLS = 10_000_000


def read_occupancy(path: str | Path, cell: float, boxes: int | None = None) -> Scene:
    """Reads a map bool [rows, columns] that is true where one can go, as Habitat's top-down maps.

    What is not free becomes boxes, each a rectangle of cells. Row i and column j lie at
    x = j · cell and z = −i · cell.

    Args:
      path: a NumPy file; of integers, all at least 0 are free (Habitat's islands).
      cell: metres a cell.
      boxes: how many rows the scene is to have; None for as many as there are.

    Raises:
      JaxactError: the file is no such map, or there are more boxes.
    """
    grid = read_array(path)
    _check_cell(cell)
    if grid.ndim != 2 or grid.dtype.kind not in "bi":
        raise JaxactError(
            f"{path} must be a map of two axes, of bools or signed integers, "
            f"not {grid.dtype}{list(grid.shape)}"
        )
    free = grid if grid.dtype == bool else grid >= 0
    return _scene(str(path), free[::-1].T, cell, (0.0, -(free.shape[0] - 1) * cell), boxes)


def read_reachable(path: str | Path, cell: float = 0.25, boxes: int | None = None) -> Scene:
    """Reads the points float [n, 2] (x, z) of a grid that can be reached, as ALFRED's layouts.

    A body of less than half a cell's radius can come to all of them, and to the cells' surface.

    Args:
      path: a NumPy file.
      cell: metres between points.
      boxes: how many rows the scene is to have; None for as many as there are.

    Raises:
      JaxactError: the file holds no such points, or there are more boxes.
    """
    points = read_array(path)
    _check_cell(cell)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points) or points.dtype.kind not in "fi":
        raise JaxactError(
            f"{path} must be points float [n, 2], not {points.dtype}{list(points.shape)}"
        )
    # NaN is not less than anything either.
    if not np.all(np.abs(points) <= LARGEST):
        raise JaxactError(f"{path} must be points of finite coordinates, of at most {LARGEST} m")
    steps = points / cell
    if np.abs(steps - np.round(steps)).max() > 0.01:
        raise JaxactError(f"{path} must be points of a grid of {cell} m")
    wide, deep = steps.max(axis=0) - steps.min(axis=0)
    if wide * deep > _MOST_CELLS:
        raise JaxactError(
            f"{path} has points over {wide:.0f} by {deep:.0f} cells, more than {_MOST_CELLS:,} in "
            "all: some are far from the others"
        )
    rows = np.round(steps).astype(np.int64)
    low = rows.min(axis=0)
    free = np.zeros(rows.max(axis=0) - low + 1, bool)
    free[tuple((rows - low).T)] = True
    return _scene(str(path), free, cell, (low[0] * cell, low[1] * cell), boxes)


def _check_cell(cell: float) -> None:
    if not 0 < cell <= LARGEST:
        raise JaxactError(f"cell must be a positive number of metres, got {cell!r}")


def _scene(
    path: str,
    free: np.ndarray,
    cell: float,
    origin: tuple[float, float],
    boxes: int | None,
) -> Scene:
    """Makes a scene of free cells bool [X, Z] whose first has its middle at `origin`."""
    free = np.pad(free, 1)
    blocks = _rectangles(~free)
    if boxes is not None and len(blocks) > boxes:
        raise JaxactError(f"{path} needs {len(blocks)} boxes, more than {boxes}")
    if not free.any():
        raise JaxactError(f"{path} has nowhere to go")
    # The middle of the padded map's first cell.
    x, z = (at - cell for at in origin)
    rows = [
        (
            x + (i + j - 1) / 2 * cell,
            _HEIGHT / 2,
            z + (k + m - 1) / 2 * cell,
            (j - i) * cell,
            _HEIGHT,
            (m - k) * cell,
            0.0,
        )
        for i, j, k, m in blocks
    ]
    at = np.argwhere(free)
    (low_x, low_z), (high_x, high_z) = at.min(axis=0), at.max(axis=0) + 1
    room = (
        x + (low_x - 0.5) * cell,
        z + (low_z - 0.5) * cell,
        x + (high_x - 0.5) * cell,
        z + (high_z - 0.5) * cell,
    )
    wall = categories.index("Wall")
    scene = make_scene(rows, [wall] * len(rows), [room], size=boxes)
    color = jnp.where(scene.present[:, None], jnp.asarray(COLORS[wall]), jnp.float32(0))
    return replace(scene, color=color)


def _rectangles(cells: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Covers cells with rectangles (first row, end row, first column, end column), greedily."""
    left = cells.copy()
    found = []
    for i, k in np.argwhere(cells):
        if not left[i, k]:
            continue
        m = k
        while m < left.shape[1] and left[i, m]:
            m += 1
        j = i + 1
        while j < len(left) and left[j, k:m].all():
            j += 1
        left[i:j, k:m] = False
        found.append((int(i), int(j), int(k), int(m)))
    return found
