"""Whether one can live in a house: can all of it be walked, and can one come to what is in it.

On the host, by rasters, rays and separating axes in NumPy, so that it shares no code with what
makes houses or walks in them. Of each box only the places near it are looked at, so that ten
thousand houses are checked in minutes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from envs_jax.houses import categories
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, SINE, Scene
from envs_jax.houses.state import Body

_STEP_OVER = 0.02
_DOORWAY = 0.1
# Metres that things may be in each other, or off what they lie on, by rounding.
_ROUNDING = 2e-3
_WALL = categories.index("Wall")
_TARGETS = np.array([categories.index(name) for name in categories.ROBOTHOR_TARGETS])


@dataclass(frozen=True)
class Problem:
    """What is wrong in a house.

    Attributes:
      reason: one word: "divided", the free space is in several parts; "shut", a body fits nowhere
        in a room; "hidden", something is not in sight from any place near it; "overlapping", two
        things are in each other; "floating", something lies on nothing.
      sentence: says of what.
    """

    reason: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence


def free_cells(
    scene: Scene, body: Body, resolution: float = 0.05
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds where a body fits, among the multiples of `resolution` in rooms and doorways.

    Returns:
      bool [X, Z] whether it does, and the coordinates float64 [X] and [Z].
    """
    rooms = _rooms(scene)
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
        free[_between(x, x_low, x_high), _between(z, z_low, z_high)] = True
    for box, (reach_x, reach_z) in zip(boxes, _reach(boxes) + body.radius, strict=True):
        across = _between(x, box[0] - reach_x, box[0] + reach_x)
        along = _between(z, box[2] - reach_z, box[2] + reach_z)
        u, v = _local(box, x[across, None] - box[0], z[None, along] - box[2])
        beside = np.maximum(np.abs(u) - box[HALF_SIZE][0], 0)
        ahead = np.maximum(np.abs(v) - box[HALF_SIZE][2], 0)
        # A body may touch things; what is written as 5 cm must not be an obstacle by rounding.
        free[across, along] &= np.hypot(beside, ahead) >= body.radius - 1e-6
    return free, x, z


def components(free: np.ndarray) -> int:
    """Returns in how many parts free cells bool [X, Z] fall, where one may go diagonally."""
    return int(ndimage.label(free, np.ones((3, 3)))[1])


def problems(
    scene: Scene, body: Body, within: float = 1.0, resolution: float = 0.05
) -> list[Problem]:
    """Says what is wrong with one house; nothing if it is sound.

    Args:
      scene: without leading axes.
      body: who is to live there.
      within: metres in plan from which what RoboTHOR has one look for must be seen by the body's
        camera as the house stands, and what can be carried so or once everything is open.
      resolution: metres between the places that are looked at.
    """
    free, x, z = free_cells(scene, body, resolution)
    found = []
    if (parts := components(free)) != 1:
        found.append(Problem("divided", f"the free space is in {parts} parts"))
    for i, (x_low, z_low, x_high, z_high) in enumerate(_rooms(scene)):
        if not free[_between(x, x_low, x_high), _between(z, z_low, z_high)].any():
            found.append(Problem("shut", f"a body fits nowhere in room {i}"))
    category = np.asarray(scene.category)
    present = np.asarray(scene.present)
    boxes, openable = np.asarray(scene.boxes, np.float64), np.asarray(scene.openable)
    shut = (openable & ~np.asarray(scene.opened))[:, None]
    opened = np.where(shut, np.asarray(scene.other_boxes, np.float64), boxes)
    targets = np.isin(category, _TARGETS) & present
    name = [f"the {categories.NAMES[kind]} of row {row}" for row, kind in enumerate(category)]
    found += [
        Problem("hidden", f"{name[row]} cannot be seen")
        for row in np.nonzero(targets | (np.asarray(scene.portable) & present))[0].tolist()
        if not _seen(boxes, row, free, x, z, body, within)
        and (targets[row] or not _seen(opened, row, free, x, z, body, within))
    ]
    # Doors and windows are in walls, and what is shut in or on what it belongs to.
    solid = np.nonzero(present & ((category == _WALL) | (category >= len(categories.STRUCTURE))))[0]
    found += [
        Problem("overlapping", f"{name[solid[i]]} and {name[solid[j]]} are in each other")
        for i, j in _overlaps(opened[solid])
        if category[solid[i]] != _WALL or category[solid[j]] != _WALL
    ]
    found += [
        Problem("floating", f"{name[row]} lies on nothing")
        for row in solid.tolist()
        if category[row] != _WALL and not openable[row] and not _lies(boxes[solid], boxes[row])
    ]
    return found


def _rooms(scene: Scene) -> np.ndarray:
    """Returns the rooms that are used, float64 [R, 4]."""
    rooms = np.asarray(scene.rooms, np.float64)
    return rooms[rooms[:, 2] > rooms[:, 0]]


def _between(axis: np.ndarray, low: float, high: float) -> slice:
    """Returns which of ascending coordinates are in [low, high]."""
    return slice(int(np.searchsorted(axis, low)), int(np.searchsorted(axis, high, "right")))


def _reach(boxes: np.ndarray) -> np.ndarray:
    """Returns half the extents along x and z, float64 [N, 2], of boxes [N, 8]."""
    cosine, sine = np.abs(boxes[:, COSINE]), np.abs(boxes[:, SINE])
    across, ahead = boxes[:, HALF_SIZE][:, 0], boxes[:, HALF_SIZE][:, 2]
    return np.stack([cosine * across + sine * ahead, sine * across + cosine * ahead], axis=1)


def _local(box: np.ndarray, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns plan vectors into a box's own axes."""
    cosine, sine = box[COSINE], box[SINE]
    return cosine * x - sine * z, sine * x + cosine * z


def _seen(
    boxes: np.ndarray,
    row: int,
    free: np.ndarray,
    x: np.ndarray,
    z: np.ndarray,
    body: Body,
    within: float,
) -> bool:
    """Returns whether the middle of a box's upper half is in sight of the camera at some place."""
    target = boxes[row, CENTER] + np.array([0, boxes[row, HALF_SIZE][1] / 2, 0])
    across = _between(x, target[0] - within, target[0] + within)
    along = _between(z, target[2] - within, target[2] + within)
    x, z = np.meshgrid(x[across], z[along], indexing="ij")
    good = free[across, along] & (np.hypot(x - target[0], z - target[2]) <= within)
    near = np.stack([x[good], z[good]], axis=1)
    # Only what is as near to the target as the camera can be between the two.
    others = np.delete(boxes, row, axis=0)
    away = np.abs(others[:, [0, 2]] - target[[0, 2]]) - _reach(others)
    others = others[np.all(away <= within, axis=1)]
    # A few of the places will do, unless none of them does.
    few = near[:: max(1, len(near) // 100)]
    return any(_in_sight(others, chosen, target, body) for chosen in (few, near))


def _in_sight(others: np.ndarray, places: np.ndarray, target: np.ndarray, body: Body) -> bool:
    """Returns whether no box is between the camera at some place and a target."""
    eyes = np.insert(places, 1, body.camera_height, axis=1)
    blocked = np.zeros(len(eyes), bool)
    for other in others:
        start, way = eyes - other[CENTER], target - eyes
        start[:, 0], start[:, 2] = _local(other, start[:, 0], start[:, 2])
        way[:, 0], way[:, 2] = _local(other, way[:, 0], way[:, 2])
        way = np.where(np.abs(way) < 1e-9, 1e-9, way)
        near_side = -start / way - other[HALF_SIZE] / np.abs(way)
        far_side = -start / way + other[HALF_SIZE] / np.abs(way)
        enter = np.maximum(np.max(near_side, axis=1), 0)
        blocked |= enter < np.minimum(np.min(far_side, axis=1), 1)
    return bool(np.any(~blocked))


def _overlaps(boxes: np.ndarray) -> list[tuple[int, int]]:
    """Returns the pairs of boxes [N, 8] that are in each other by more than rounding."""
    center, half = boxes[:, CENTER], boxes[:, HALF_SIZE] - _ROUNDING / 2
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]
    # Of each box its own x and z axes, in plan.
    axes = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], axis=1)
    offset = center[None] - center[:, None]
    apart = np.abs(offset[..., 1]) >= half[:, None, 1] + half[None, :, 1]
    # Along the axes [i, a] of box i: how far apart the centres are, and how far box j reaches.
    between = np.abs(np.einsum("ijk,iak->ija", offset[..., ::2], axes))
    turned = np.abs(np.einsum("iak,jbk->ijab", axes, axes))
    reach = np.einsum("ijab,jb->ija", turned, half[:, ::2])
    beside = np.any(between >= half[:, None, ::2] + reach, axis=-1)
    first, second = np.nonzero(~(apart | beside | beside.T))
    return [(i, j) for i, j in zip(first.tolist(), second.tolist(), strict=True) if i < j]


def _lies(boxes: np.ndarray, box: np.ndarray) -> bool:
    """Returns whether a box is on the floor or has its middle on another."""
    bottom = box[1] - box[HALF_SIZE][1]
    tops = boxes[:, 1] + boxes[:, HALF_SIZE][:, 1]
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]
    x, z = box[0] - boxes[:, 0], box[2] - boxes[:, 2]
    local = np.abs(np.stack([cosine * x - sine * z, sine * x + cosine * z], axis=1))
    under = np.all(local <= boxes[:, HALF_SIZE][:, ::2], axis=1)
    return bool(abs(bottom) <= _ROUNDING or np.any(under & (np.abs(tops - bottom) <= _ROUNDING)))
