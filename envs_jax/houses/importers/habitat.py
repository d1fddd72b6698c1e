"""Episodes of Habitat's PointNav and ObjectNav data sets, in this library's frame.

Habitat's frame is right-handed with −z forward and yaw counter-clockwise; here z is forward and yaw
clockwise. A point (x, y, z) there is (x, y, −z) here, and an angle changes its sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envs_jax.houses.importers.reading import field, read_json
from jaxact.errors import JaxactError

_Source = str | Path
Point = tuple[float, float, float]


@dataclass(frozen=True)
class HabitatGoal:
    """Where a goal is, and from where it is seen.

    Attributes:
      position: (x, y, z) in this library's frame.
      category: of an object; empty for a point.
      view_points: likewise (x, y, z); none for a point.
    """

    position: Point
    category: str
    view_points: tuple[Point, ...]


@dataclass(frozen=True)
class HabitatEpisode:
    """One episode.

    Attributes:
      id: of the episode.
      scene: its file in the data set.
      position: (x, y, z) at the start, in this library's frame.
      yaw: degrees at the start, clockwise from +z.
      category: what to find; empty for a point.
      goals: any of which will do.
      geodesic_distance: metres, as stored; None if it is not.
    """

    id: str
    scene: str
    position: Point
    yaw: float
    category: str
    goals: tuple[HabitatGoal, ...]
    geodesic_distance: float | None


def from_habitat(x: float, y: float, z: float) -> Point:
    """Turns a point of Habitat's frame into this library's; it is its own inverse."""
    return x, y, -z


def yaw_of(rotation: tuple[float, float, float, float]) -> float:
    """Returns the yaw in [0, 360) of Habitat's quaternion (x, y, z, w) about the y axis."""
    _, y, _, w = rotation
    return -math.degrees(2 * math.atan2(y, w)) % 360


def rotation_of(yaw: float) -> tuple[float, float, float, float]:
    """Returns Habitat's quaternion (x, y, z, w) of a yaw in degrees."""
    half = math.radians(-yaw) / 2
    return 0.0, math.sin(half), 0.0, math.cos(half)


def read_episodes(path: _Source) -> list[HabitatEpisode]:
    """Reads an episode file, compressed or not.

    Raises:
      JaxactError: the file is no such file; or it has only the list of scenes, whose episodes are
        in the folder "content" beside it.
    """
    data = read_json(path)
    records = field(path, "the data set", data, "episodes", list)
    if not records:
        raise JaxactError(f"{path} has no episodes: read the files in the folder 'content' instead")
    by_category = data.get("goals_by_category") or {}
    if not isinstance(by_category, Mapping):
        raise JaxactError(f"{path}: 'goals_by_category' must be an object")
    # Episodes share goals, of which there are many view points.
    shared = {
        name: tuple(_goal(path, f"goal of {name}", goal) for goal in goals)
        for name, goals in by_category.items()
    }
    return [_episode(path, f"episode {i}", record, shared) for i, record in enumerate(records)]


def _episode(
    path: _Source, where: str, record: Any, shared: Mapping[str, tuple[HabitatGoal, ...]]
) -> HabitatEpisode:
    scene = field(path, where, record, "scene_id", str)
    category = str(record.get("object_category") or "")
    goals = tuple(_goal(path, where, goal) for goal in record.get("goals") or ())
    if category and not goals:
        name = f"{scene.rsplit('/', 1)[-1]}_{category}"
        if name not in shared:
            raise JaxactError(f"{path}: {where} looks for {name!r}, of which there are no goals")
        goals = shared[name]
    rotation = field(path, where, record, "start_rotation", list)
    if len(rotation) != 4 or not all(isinstance(part, int | float) for part in rotation):
        raise JaxactError(f"{path}: 'start_rotation' of {where} must be four numbers")
    info = record.get("info") or {}
    stored = info.get("geodesic_distance")
    x, y, z, w = rotation
    return HabitatEpisode(
        id=str(record.get("episode_id", "")),
        scene=scene,
        position=_point(path, where, field(path, where, record, "start_position", list)),
        yaw=yaw_of((x, y, z, w)),
        category=category,
        goals=goals,
        geodesic_distance=None if stored is None else float(stored),
    )


def _goal(path: _Source, where: str, record: Any) -> HabitatGoal:
    position = _point(path, where, field(path, where, record, "position", list))
    views = []
    for view in record.get("view_points") or ():
        state = field(path, where, view, "agent_state", dict)
        views.append(_point(path, where, field(path, where, state, "position", list)))
    return HabitatGoal(position, str(record.get("object_category") or ""), tuple(views))


def _point(path: _Source, where: str, values: list) -> Point:
    if len(values) != 3 or not all(isinstance(value, int | float) for value in values):
        raise JaxactError(f"{path}: a position of {where} must be three numbers")
    x, y, z = values
    return from_habitat(float(x), float(y), float(z))
