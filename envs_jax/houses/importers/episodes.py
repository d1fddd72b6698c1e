"""What a file says of one episode of navigation, whatever its format."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxact.errors import JaxactError

Point = tuple[float, float, float]


@dataclass(frozen=True)
class NavigationEpisode:
    """One episode, in this library's frame: points are (x, y, z) with y up, angles degrees.

    Attributes:
      id: of the episode; no other of its scene has it.
      scene: name of the house.
      position: of the agent at the start.
      yaw: at the start, clockwise from +z seen from above.
      pitch: at the start, downwards.
      category: what to find, one of `categories.NAMES` or a name that only the file knows; empty if
        the goal is a point.
      goals: places any of which will do: the point, or those from which the category is seen; none
        where the file leaves it to the scene from where that is.
      path: corners of the shortest way; None where the file has none.
      length: metres of the shortest way; None likewise.
      difficulty: what the file calls it, such as "easy"; empty if it does not.
    """

    id: str
    scene: str
    position: Point
    yaw: float
    pitch: float = 0.0
    category: str = ""
    goals: tuple[Point, ...] = ()
    path: tuple[Point, ...] | None = None
    length: float | None = None
    difficulty: str = ""

    @property
    def polyline_length(self) -> float:
        """Metres along `path`."""
        return sum(math.dist(a, b) for a, b in itertools.pairwise(self.path or ()))


def check_ids(path: str | Path, episodes: Sequence[NavigationEpisode]) -> None:
    """Refuses a file in which two episodes of a scene have one id.

    Raises:
      JaxactError: two have; the message says which.
    """
    seen: dict[tuple[str, str], int] = {}
    for i, episode in enumerate(episodes):
        first = seen.setdefault((episode.scene, episode.id), i)
        if first != i:
            raise JaxactError(
                f"{path}: episodes {first} and {i} of scene {episode.scene!r} have the same id "
                f"{episode.id!r}; each needs its own"
            )
