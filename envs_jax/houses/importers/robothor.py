"""Episodes of the RoboTHOR ObjectNav challenge, read and written in its JSON."""

from __future__ import annotations

import gzip
import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from envs_jax.houses.importers.reading import field, read_json, vector
from jaxact.errors import JaxactError


@dataclass(frozen=True)
class RoboThorEpisode:
    """One episode.

    Attributes:
      id: of the episode.
      scene: name of the house.
      object_type: what to find.
      position: (x, y, z) of the agent's middle at the start.
      yaw: degrees at the start.
      horizon: degrees down at the start.
      path: corners (x, y, z) of the shortest path; None where it is kept secret.
      path_length: metres; None likewise.
    """

    id: str
    scene: str
    object_type: str
    position: tuple[float, float, float]
    yaw: float
    horizon: float
    path: tuple[tuple[float, float, float], ...] | None
    path_length: float | None

    @property
    def polyline_length(self) -> float:
        """Metres along `path`."""
        path = self.path or ()
        return sum(math.dist(a, b) for a, b in itertools.pairwise(path))


def read_episodes(path: str | Path) -> list[RoboThorEpisode]:
    """Reads the episodes of one house, JSON compressed or not.

    Raises:
      JaxactError: the file is no list of such episodes.
    """
    records = read_json(path)
    if not isinstance(records, list):
        raise JaxactError(f"{path} must be a list of episodes")
    return [_episode(path, f"episode {i}", record) for i, record in enumerate(records)]


def _episode(path: str | Path, where: str, record: object) -> RoboThorEpisode:
    def position(of: object) -> tuple[float, float, float]:
        x, y, z = vector(path, where, of)
        return x, y, z

    corners = length = None
    if isinstance(record, dict) and "shortest_path" in record:
        points = field(path, where, record, "shortest_path", list)
        corners = tuple(position(point) for point in points)
        length = float(field(path, where, record, "shortest_path_length", float))
    return RoboThorEpisode(
        id=field(path, where, record, "id", str),
        scene=field(path, where, record, "scene", str),
        object_type=field(path, where, record, "object_type", str),
        position=position(field(path, where, record, "initial_position", dict)),
        yaw=float(field(path, where, record, "initial_orientation", float)),
        horizon=float(field(path, where, record, "initial_horizon", float)),
        path=corners,
        path_length=length,
    )


def write_episodes(path: str | Path, episodes: Sequence[RoboThorEpisode]) -> None:
    """Writes episodes as the challenge has them; the same episodes are the same bytes.

    Args:
      path: the file; compressed by gzip if its name ends so.
      episodes: to write.
    """

    def point(of: tuple[float, float, float]) -> dict[str, float]:
        return dict(zip("xyz", of, strict=True))

    records = []
    for episode in episodes:
        record: dict[str, object] = {
            "id": episode.id,
            "initial_horizon": episode.horizon,
            "initial_orientation": episode.yaw,
            "initial_position": point(episode.position),
            "object_type": episode.object_type,
            "scene": episode.scene,
        }
        if episode.path is not None:
            record["shortest_path"] = [point(corner) for corner in episode.path]
            record["shortest_path_length"] = episode.path_length
        records.append(record)
    data = json.dumps(records).encode()
    if str(path).endswith(".gz"):
        data = gzip.compress(data, mtime=0)
    Path(path).write_bytes(data)
