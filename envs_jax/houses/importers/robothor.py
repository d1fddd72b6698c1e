"""Episodes of RoboTHOR's data sets for PointNav and ObjectNav, read and written in their JSON.

A file is a list of episodes of one house: "scene", "initial_position", "initial_orientation" and
"initial_horizon", what to find ("object_type") or where to go ("target_position"), the corners of
the shortest path and its length, which the challenge's test files keep secret, and in some data
sets a "difficulty".

Sources: the files of the RoboTHOR challenge 2021, and AllenAct's `ObjectNavDatasetTaskSampler` and
`PointNavDatasetTaskSampler`, which read such files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from envs_jax.houses.importers.episodes import NavigationEpisode, Point, check_ids
from envs_jax.houses.importers.reading import field, optional, read_json, vector
from envs_jax.houses.importers.writing import write_json
from jaxact.errors import JaxactError


def read_episodes(path: str | Path) -> list[NavigationEpisode]:
    """Reads the episodes of a file, JSON compressed or not.

    Raises:
      JaxactError: the file is no list of such episodes, or it is empty.
    """
    records = read_json(path)
    if not isinstance(records, list):
        raise JaxactError(f"{path} must be a list of episodes, not {records!r:.40}")
    if not records:
        raise JaxactError(f"{path} has no episodes")
    episodes = [_episode(path, f"episode {i}", record) for i, record in enumerate(records)]
    check_ids(path, episodes)
    return episodes


def _episode(path: str | Path, where: str, record: Any) -> NavigationEpisode:
    def point(of: Any) -> Point:
        x, y, z = vector(path, where, of)
        return x, y, z

    name = field(path, where, record, "id", str)
    category = optional(path, where, record, "object_type", str, "")
    target = optional(path, where, record, "target_position", dict, None)
    if bool(category) == (target is not None):
        raise JaxactError(
            f"{path}: {where} must have either an 'object_type' to find or a 'target_position'"
        )
    corners = length = None
    if "shortest_path" in record:
        points = field(path, where, record, "shortest_path", list)
        if not points:
            raise JaxactError(f"{path}: 'shortest_path' of {where} must have a corner")
        corners = tuple(point(corner) for corner in points)
        length = field(path, where, record, "shortest_path_length", float)
        if length < 0:
            raise JaxactError(
                f"{path}: 'shortest_path_length' of {where} must not be negative, but is {length}"
            )
    orientation = record.get("initial_orientation")
    # Some data sets of PointNav give all three of Unity's angles.
    if isinstance(orientation, dict):
        yaw = field(path, f"'initial_orientation' of {where}", orientation, "y", float)
    else:
        yaw = field(path, where, record, "initial_orientation", float)
    return NavigationEpisode(
        id=name,
        scene=field(path, where, record, "scene", str),
        position=point(field(path, where, record, "initial_position", dict)),
        yaw=yaw,
        pitch=optional(path, where, record, "initial_horizon", float, 0.0),
        category=category,
        goals=() if target is None else (point(target),),
        path=corners,
        length=length,
        difficulty=optional(path, where, record, "difficulty", str, ""),
    )


def write_episodes(path: str | Path, episodes: Sequence[NavigationEpisode]) -> None:
    """Writes episodes as the challenge has them; the same episodes are the same bytes.

    Args:
      path: the file; compressed by gzip if its name ends in ".gz". It is written whole or not at
        all.
      episodes: to write.

    Raises:
      JaxactError: an episode neither finds a category nor has one point to go to, or the file
        cannot be written.
    """

    def point(of: Point) -> dict[str, float]:
        return dict(zip("xyz", of, strict=True))

    records = []
    for episode in episodes:
        record: dict[str, object] = {
            "id": episode.id,
            "initial_horizon": episode.pitch,
            "initial_orientation": episode.yaw,
            "initial_position": point(episode.position),
            "scene": episode.scene,
        }
        if episode.category:
            record["object_type"] = episode.category
        elif len(episode.goals) == 1:
            record["target_position"] = point(episode.goals[0])
        else:
            raise JaxactError(
                f"episode {episode.id!r} in scene {episode.scene!r} must have a category to find "
                f"or one point to go to, but has {len(episode.goals)} points"
            )
        if episode.path is not None:
            record["shortest_path"] = [point(corner) for corner in episode.path]
            record["shortest_path_length"] = episode.length
        if episode.difficulty:
            record["difficulty"] = episode.difficulty
        records.append(record)
    write_json(path, records)
