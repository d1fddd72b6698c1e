"""Whether one can live in a house: can all of it be walked, and can one come to what is in it.

On the host, by rasters and rays in NumPy, so that it shares no code with what makes houses or walks
in them.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from envs_jax.houses import categories
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, SINE, Scene
from envs_jax.houses.state import Body

_STEP_OVER = 0.02
_DOORWAY = 0.1


def free_cells(
    scene: Scene, body: Body, resolution: float = 0.05
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds where a body fits, among the multiples of `resolution` in rooms and doorways.

    Returns:
      bool [X, Z] whether it does, and the coordinates float64 [X] and [Z].
    """
    rooms = np.asarray(scene.rooms, np.float64)
    rooms = rooms[rooms[:, 2] > rooms[:, 0]]
    low = np.ceil(np.min(rooms[:, :2], axis=0) / resolution)
    high = np.floor(np.max(rooms[:, 2:], axis=0) / resolution)
    x, z = (np.arange(a, b + 1) * resolution for a, b in zip(low, high, strict=True))
    boxes = np.asarray(scene.boxes, np.float64)[np.asarray(scene.present)]
    bottom = boxes[:, 1] - boxes[:, HALF_SIZE][:, 1]
    top = boxes[:, 1] + boxes[:, HALF_SIZE][:, 1]
    boxes = boxes[(bottom < body.height) & (top > _STEP_OVER)]
    # Doorways are between rooms, and what is further out is outside.
    free = np.zeros((len(x), len(z)), bool)
    for x_low, z_low, x_high, z_high in rooms + _DOORWAY * np.array([-1, -1, 1, 1]):
        within = (x >= x_low) & (x <= x_high)
        free |= within[:, None] & (z >= z_low) & (z <= z_high)
    for box in boxes:
        u, v = _local(box, x[:, None] - box[0], z[None] - box[2])
        across = np.maximum(np.abs(u) - box[HALF_SIZE][0], 0)
        ahead = np.maximum(np.abs(v) - box[HALF_SIZE][2], 0)
        # A body may touch things; what is written as 5 cm must not be an obstacle by rounding.
        free &= np.hypot(across, ahead) >= body.radius - 1e-6
    return free, x, z


def components(free: np.ndarray) -> int:
    """Returns in how many parts free cells bool [X, Z] fall, where one may go diagonally."""
    return int(ndimage.label(free, np.ones((3, 3)))[1])


def problems(scene: Scene, body: Body, within: float = 1.0, resolution: float = 0.05) -> list[str]:
    """Says what is wrong with one house, in a sentence each; nothing if it is sound.

    Args:
      scene: without leading axes.
      body: who is to live there.
      within: metres in plan from which what can be carried, and what RoboTHOR has one look for,
        must be seen by the body's camera.
      resolution: metres between the places that are looked at.
    """
    free, x, z = free_cells(scene, body, resolution)
    parts = components(free)
    found = []
    if parts != 1:
        found.append(f"the free space is in {parts} parts")
    places = np.stack([x[np.nonzero(free)[0]], z[np.nonzero(free)[1]]], axis=1)
    category = np.asarray(scene.category)
    targets = np.isin(category, [categories.index(name) for name in categories.ROBOTHOR_TARGETS])
    wanted = (targets | np.asarray(scene.portable)) & np.asarray(scene.present)
    boxes = np.asarray(scene.boxes, np.float64)
    for row in np.nonzero(wanted)[0].tolist():
        if not _seen(boxes, row, places, body, within):
            found.append(f"the {categories.NAMES[category[row]]} of row {row} cannot be seen")
    return found


def _local(box: np.ndarray, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns plan vectors into a box's own axes."""
    cosine, sine = box[COSINE], box[SINE]
    return cosine * x - sine * z, sine * x + cosine * z


def _seen(boxes: np.ndarray, row: int, places: np.ndarray, body: Body, within: float) -> bool:
    """Returns whether the middle of a box's upper half is in sight of the camera at some place."""
    target = boxes[row, CENTER] + np.array([0, boxes[row, HALF_SIZE][1] / 2, 0])
    distance = np.hypot(places[:, 0] - target[0], places[:, 1] - target[2])
    near = places[distance <= within]
    # A few of the places will do, unless none of them does.
    few = near[:: max(1, len(near) // 100)]
    return any(_in_sight(boxes, row, chosen, target, body) for chosen in (few, near))


def _in_sight(
    boxes: np.ndarray, row: int, places: np.ndarray, target: np.ndarray, body: Body
) -> bool:
    """Returns whether nothing is between the camera at some place and a point of a box."""
    eyes = np.insert(places, 1, body.camera_height, axis=1)
    blocked = np.zeros(len(eyes), bool)
    for other in np.delete(boxes, row, axis=0):
        start, way = eyes - other[CENTER], target - eyes
        start[:, 0], start[:, 2] = _local(other, start[:, 0], start[:, 2])
        way[:, 0], way[:, 2] = _local(other, way[:, 0], way[:, 2])
        way = np.where(np.abs(way) < 1e-9, 1e-9, way)
        near_side = -start / way - other[HALF_SIZE] / np.abs(way)
        far_side = -start / way + other[HALF_SIZE] / np.abs(way)
        enter = np.maximum(np.max(near_side, axis=1), 0)
        blocked |= enter < np.minimum(np.min(far_side, axis=1), 1)
    return bool(np.any(~blocked))
