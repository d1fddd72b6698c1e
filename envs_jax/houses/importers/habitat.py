"""Episodes of Habitat's PointNav and ObjectNav data sets, in this library's frame.

Habitat's frame is right-handed with −z forward and yaw counter-clockwise; here z is forward and yaw
clockwise. A point (x, y, z) there is (x, y, −z) here, and an angle changes its sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs_jax.houses.importers.episodes import NavigationEpisode, Point, check_ids
from envs_jax.houses.importers.reading import field, numbers, optional, read_json
from jaxact.errors import JaxactError

_Source = str | Path
# What HM3D's and MP3D's objects are here; those that are missing keep their own names.
CATEGORIES = {
    "bathtub": "Bathtub",
    "bed": "Bed",
    "cabinet": "Cabinet",
    "chair": "Chair",
    "chest_of_drawers": "Dresser",
    "clothes": "Cloth",
    "counter": "CounterTop",
    "cushion": "Pillow",
    "picture": "Painting",
    "plant": "HousePlant",
    "shower": "ShowerGlass",
    "sink": "Sink",
    "sofa": "Sofa",
    "stool": "Stool",
    "table": "DiningTable",
    "toilet": "Toilet",
    "towel": "Towel",
    "tv_monitor": "Television",
}


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


def read_episodes(path: _Source) -> list[NavigationEpisode]:
    """Reads an episode file, compressed or not.

    The goals of an episode are its points or, of objects, the view points of all instances; where
    there are none, it is left to the scene from where an instance is seen.

    Raises:
      JaxactError: the file is no such file; or it has only the list of scenes, whose episodes are
        in the folder "content" beside it.
    """
    data = read_json(path)
    records = field(path, "the data set", data, "episodes", list)
    if not records:
        raise JaxactError(f"{path} has no episodes: read the files in the folder 'content' instead")
    by_category = optional(path, "the data set", data, "goals_by_category", dict, {})
    # Episodes share goals, of which there are many view points.
    shared = {
        name: _places(path, f"{name!r} of 'goals_by_category'", by_category, name)
        for name in by_category
    }
    episodes = [_episode(path, f"episode {i}", record, shared) for i, record in enumerate(records)]
    check_ids(path, episodes)
    return episodes


def _episode(
    path: _Source, where: str, record: Any, shared: Mapping[str, tuple[Point, ...]]
) -> NavigationEpisode:
    scene = field(path, where, record, "scene_id", str)
    category = optional(path, where, record, "object_category", str, "")
    name = record.get("episode_id")
    if isinstance(name, bool) or not isinstance(name, str | int):
        raise JaxactError(f"{path}: 'episode_id' of {where} must be a string, not {name!r:.40}")
    if record.get("goals"):
        goals = _places(path, where, record, "goals")
    elif category:
        key = f"{scene.rsplit('/', 1)[-1]}_{category}"
        if key not in shared:
            raise JaxactError(f"{path}: {where} looks for {key!r}, of which there are no goals")
        goals = shared[key]
    else:
        raise JaxactError(f"{path}: {where} has no goals, and no 'object_category' to find")
    x, y, z, w = numbers(path, where, record, "start_rotation", 4)
    if abs(math.hypot(x, y, z, w) - 1) > 0.01:
        raise JaxactError(
            f"{path}: 'start_rotation' of {where} must be a unit quaternion, not {[x, y, z, w]}"
        )
    info = optional(path, where, record, "info", dict, {})
    length = optional(path, f"'info' of {where}", info, "geodesic_distance", float, None)
    if length is not None and length < 0:
        raise JaxactError(
            f"{path}: 'geodesic_distance' of {where} must not be negative, but is {length}"
        )
    return NavigationEpisode(
        id=str(name),
        scene=scene,
        position=_point(path, where, record, "start_position"),
        yaw=yaw_of((x, y, z, w)),
        category=CATEGORIES.get(category, category),
        goals=goals,
        length=length,
    )


def _places(path: _Source, where: str, record: Any, name: str) -> tuple[Point, ...]:
    """Returns where goals are to be come to: at points, or at the view points of objects."""
    places = []
    for i, goal in enumerate(field(path, where, record, name, list)):
        which = f"goal {i} of {where}"
        position = _point(path, which, goal, "position")
        views = optional(path, which, goal, "view_points", list, [])
        for view in views:
            state = field(path, f"a view point of {which}", view, "agent_state", dict)
            places.append(_point(path, f"a view point of {which}", state, "position"))
        if not views and not goal.get("object_category"):
            places.append(position)
    return tuple(places)


def _point(path: _Source, where: str, record: Any, name: str) -> Point:
    x, y, z = numbers(path, where, record, name, 3)
    return from_habitat(x, y, z)
