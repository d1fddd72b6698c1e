"""AI2-THOR's controller as an environment of Gymnasium: walks, views and distances.

It judges nothing: rewards are zero, and only "end" terminates. What a task needs is in `info`, see
`METRICS`. Every number that can be asked of the simulator is the simulator's: what is visible, and
how far the goal is along its navigation mesh.

Sources: AI2-THOR's documentation of navigation and of its events' metadata; ai2thor 5.0.0, whose
simulator wants the end of a path as `target` (https://github.com/allenai/ai2thor/issues/1155),
though its own `ai2thor.util.metrics` still says x, y and z; AllenAct's `RoboThorEnvironment` for
which errors are allowed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium
import numpy as np

from envs_jax.houses.importers.episodes import NavigationEpisode, Point
from jaxact.errors import JaxactError, unknown

# What `info` has: geodesic metres to the goal, and from the start; metres walked, in all and in the
# last step; whether the target is visible; whether the last action failed.
METRICS = ("distance_to_goal", "shortest", "path_length", "moved", "visible", "refused")
# The controller's name of each action, of its amount, and which of a body's numbers that is.
ACTIONS = {
    "move_ahead": ("MoveAhead", "moveMagnitude", "step_size"),
    "move_back": ("MoveBack", "moveMagnitude", "step_size"),
    "rotate_left": ("RotateLeft", "degrees", "turn"),
    "rotate_right": ("RotateRight", "degrees", "turn"),
    "look_up": ("LookUp", "degrees", "look"),
    "look_down": ("LookDown", "degrees", "look"),
}
END = "end"
VIEWS = ("rgb", "depth")
# Metres by which ends of a path may be off the mesh: the first that finds a path is taken.
_ALLOWED_ERRORS = tuple(0.05 * 2**i for i in range(6))
# So many starts and goals are drawn before a scene is given up.
_DRAWS = 100


class Event(Protocol):
    """What the controller returns.

    Attributes:
      frame: uint8 [H, W, 3].
      depth_frame: float32 [H, W], metres; None without `renderDepthImage`.
      metadata: "agent", "objects", "lastActionSuccess", "errorMessage", "actionReturn" and more.
    """

    frame: Any
    depth_frame: Any
    metadata: Mapping[str, Any]


class Controller(Protocol):
    """What is needed of `ai2thor.controller.Controller`."""

    def reset(self, scene: Any) -> Event:
        """Loads a scene, by its name or as a house of ProcTHOR's."""
        ...

    def step(self, action: str, **arguments: Any) -> Event:
        """Acts, or asks something."""
        ...

    def stop(self) -> None:
        """Ends the process."""
        ...


@dataclass(frozen=True)
class Walks:
    """Which episodes there are to walk, and how.

    Attributes:
      actions: names out of `ACTIONS`, and "end".
      episodes: to walk, the seed's remainder of them; empty to draw from `scenes`.
      scenes: names of scenes, in which starts and goals are drawn.
      targets: object types, to find; empty for goals that are points.
      step_size: metres of a move.
      turn: degrees.
      look: degrees.
      pitch: degrees down at which episodes that are drawn begin.
      least: metres, the shortest way to the goal of an episode that is drawn.
    """

    actions: tuple[str, ...]
    episodes: tuple[NavigationEpisode, ...] = ()
    scenes: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    step_size: float = 0.25
    turn: float = 30.0
    look: float = 30.0
    pitch: float = 0.0
    least: float = 0.0

    def __post_init__(self) -> None:
        for name in self.actions:
            if name not in (*ACTIONS, END):
                raise unknown("action of AI2-THOR", name, (*ACTIONS, END))
        if bool(self.episodes) == bool(self.scenes):
            raise JaxactError("AI2-THOR needs either episodes or the names of scenes to draw in")
        for episode in self.episodes:
            if bool(episode.category) != bool(self.targets):
                wanted = "an object type to find" if self.targets else "a point to go to"
                raise JaxactError(f"episode {episode.id!r} must have {wanted}")
            if episode.category and episode.category not in self.targets:
                raise unknown(f"target of episode {episode.id!r}", episode.category, self.targets)


@dataclass
class ThorSimulator(gymnasium.Env[Any, Any]):
    """One controller. Observations are "place", float32 [4] (x, z, yaw and pitch), "goal" (a point
    float32 [2], x and z, or the target's number), and the views asked for.

    Attributes:
      controller: of AI2-THOR, with views of `height` by `width` pixels.
      walks: the episodes.
      views: out of "rgb" (uint8 [H, W, 3]) and "depth" (float32 [H, W, 1], metres).
      height, width: pixels.
    """

    controller: Controller
    walks: Walks
    views: tuple[str, ...] = ()
    height: int = 64
    width: int = 64
    _distance: float = field(default=math.inf, init=False)
    _reachable: dict[str, list[Mapping[str, float]]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        for name in self.views:
            if name not in VIEWS:
                raise unknown("view of AI2-THOR", name, VIEWS)
        box, targets = gymnasium.spaces.Box, len(self.walks.targets)
        shape = (self.height, self.width)
        spaces: dict[str, gymnasium.Space[Any]] = {
            "place": box(-np.inf, np.inf, (4,), np.float32),
            "goal": gymnasium.spaces.Discrete(targets)
            if targets
            else box(-np.inf, np.inf, (2,), np.float32),
            "rgb": box(0, 255, (*shape, 3), np.uint8),
            "depth": box(0, np.inf, (*shape, 1), np.float32),
        }
        seen = ("place", "goal", *self.views)
        self.observation_space = gymnasium.spaces.Dict({name: spaces[name] for name in seen})
        self.action_space = gymnasium.spaces.Discrete(len(self.walks.actions))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins the seed's episode.

        Raises:
          JaxactError: the scene has no such episode.
        """
        super().reset(seed=seed)
        if self.walks.episodes:
            self._begin_listed(self.walks.episodes[(seed or 0) % len(self.walks.episodes)])
        else:
            self._begin_drawn()
        self._shortest, self._walked, self._moved, self._refused = self._distance, 0.0, 0.0, False
        return self._observation(), self._info()

    def step(self, action: int) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Acts; "end" asks nothing of the simulator."""
        name = self.walks.actions[action]
        self._moved, self._refused = 0.0, False
        if name != END:
            before = self._position
            called, amount, number = ACTIONS[name]
            self._event = self.controller.step(called, **{amount: getattr(self.walks, number)})
            self._refused = not self._event.metadata["lastActionSuccess"]
            self._moved = math.dist(_plan(before), _plan(self._position))
            self._walked += self._moved
            distance = self._ask_distance() if self._moved else None
            # Where the simulator finds no way, the goal counts as far away as before.
            self._distance = self._distance if distance is None else distance
        return self._observation(), 0.0, name == END, False, self._info()

    def close(self) -> None:
        """Ends the controller's process."""
        self.controller.stop()

    @property
    def _position(self) -> Point:
        at = self._event.metadata["agent"]["position"]
        return at["x"], at["y"], at["z"]

    def _begin_listed(self, episode: NavigationEpisode) -> None:
        self._load(episode.scene)
        self._target, self._goal = episode.category, next(iter(episode.goals), None)
        if not self._teleport(episode.position, episode.yaw, episode.pitch):
            raise JaxactError(
                f"episode {episode.id!r} cannot begin at {episode.position} in {episode.scene}: "
                f"{self._event.metadata['errorMessage']}"
            )
        distance = self._ask_distance()
        if distance is None:
            raise JaxactError(f"episode {episode.id!r} has no way to its goal in {episode.scene}")
        self._distance = distance

    def _begin_drawn(self) -> None:
        walks, chance = self.walks, self.np_random
        scene = walks.scenes[chance.integers(len(walks.scenes))]
        self._load(scene)
        if scene not in self._reachable:
            found = self.controller.step("GetReachablePositions").metadata["actionReturn"]
            self._reachable[scene] = sorted(found, key=lambda at: (at["x"], at["z"]))
        places = self._reachable[scene]
        for _ in range(_DRAWS):
            start, goal = (places[chance.integers(len(places))] for _ in range(2))
            turns = chance.integers(round(360 / walks.turn))
            self._goal = None if walks.targets else (goal["x"], goal["y"], goal["z"])
            self._target = (
                walks.targets[chance.integers(len(walks.targets))] if walks.targets else ""
            )
            at = start["x"], start["y"], start["z"]
            if not self._teleport(at, float(turns) * walks.turn, walks.pitch):
                continue
            distance = self._ask_distance()
            if distance is not None and distance >= walks.least:
                self._distance = distance
                return
        raise JaxactError(f"no episode was found in {scene} in {_DRAWS} draws of start and goal")

    def _load(self, scene: str) -> None:
        self._event = self.controller.reset(scene)
        if not self._event.metadata["lastActionSuccess"]:
            raise JaxactError(
                f"AI2-THOR could not load {scene!r}: {self._event.metadata['errorMessage']}"
            )

    def _teleport(self, position: Point, yaw: float, pitch: float) -> bool:
        self._event = self.controller.step(
            "Teleport",
            position=_point(position),
            rotation={"x": 0.0, "y": yaw, "z": 0.0},
            horizon=pitch,
        )
        return bool(self._event.metadata["lastActionSuccess"])

    def _ask_distance(self) -> float | None:
        """Returns the geodesic metres to the goal; None where the simulator finds no way."""
        start = self._position
        for error in _ALLOWED_ERRORS:
            if self._goal is None:
                found = self.controller.step(
                    "GetShortestPath",
                    objectType=self._target,
                    position=_point(start),
                    allowedError=error,
                )
            else:
                found = self.controller.step(
                    "GetShortestPathToPoint",
                    position=_point(start),
                    target=_point(self._goal),
                    allowedError=error,
                )
            if not found.metadata["lastActionSuccess"]:
                continue
            corners = [
                (at["x"], at["y"], at["z"]) for at in found.metadata["actionReturn"]["corners"]
            ]
            # The path may begin and end off the places that were asked for.
            length = math.dist(_plan(start), _plan(corners[0]))
            if self._goal is not None:
                length += math.dist(_plan(self._goal), _plan(corners[-1]))
            return length + sum(math.dist(a, b) for a, b in itertools.pairwise(corners))
        return None

    def _observation(self) -> dict[str, np.ndarray]:
        agent = self._event.metadata["agent"]
        x, _, z = self._position
        place = [x, z, agent["rotation"]["y"] % 360, agent["cameraHorizon"]]
        seen: dict[str, Any] = {"place": np.asarray(place, np.float32)}
        if self._goal is None:
            seen["goal"] = self.walks.targets.index(self._target)
        else:
            seen["goal"] = np.asarray(_plan(self._goal), np.float32)
        if "rgb" in self.views:
            seen["rgb"] = self._event.frame
        if "depth" in self.views:
            seen["depth"] = np.asarray(self._event.depth_frame, np.float32)[..., None]
        return seen

    def _info(self) -> dict[str, Any]:
        visible = any(
            thing["visible"] and thing["objectType"] == self._target
            for thing in self._event.metadata["objects"]
        )
        said = (self._distance, self._shortest, self._walked, self._moved, visible, self._refused)
        return {name: float(value) for name, value in zip(METRICS, said, strict=True)}


def _plan(point: Sequence[float]) -> tuple[float, float]:
    """Returns x and z."""
    return point[0], point[2]


def _point(point: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, point), strict=True))


def make_simulator(
    make_controller: Callable[..., Controller] | None,
    settings: Mapping[str, Any],
    walks: Walks,
    views: tuple[str, ...],
) -> ThorSimulator:
    """Starts a controller.

    Args:
      make_controller: `ai2thor.controller.Controller` or what is called like it; None for that.
      settings: its arguments, with "width" and "height".
      walks: the episodes.
      views: see `ThorSimulator`.

    Raises:
      JaxactError: AI2-THOR is not installed.
    """
    if make_controller is None:
        try:
            from ai2thor.controller import Controller as make
        except ImportError:
            raise JaxactError(
                "AI2-THOR's scenes need ai2thor, which is not installed: pip install ai2thor"
            ) from None
        make_controller = make
    return ThorSimulator(
        make_controller(**settings), walks, views, settings["height"], settings["width"]
    )
