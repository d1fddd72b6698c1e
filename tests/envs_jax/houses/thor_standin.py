"""A stand-in for `ai2thor.controller.Controller`: its API, in one empty room with two mugs."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

# The room is [0, SIDE]² in x and z, at the height of the agent.
SIDE, HEIGHT = 3.0, 0.9
SCENES = ("FloorPlan_Train1_1", "FloorPlan_Val1_1")
MUGS = ((2.5, 1.0, 2.5), (0.25, 1.0, 2.5))
# The arguments of each action, those that have to be given first.
SIGNATURES: dict[str, tuple[set[str], set[str]]] = {
    "MoveAhead": (set(), {"moveMagnitude"}),
    "RotateLeft": (set(), {"degrees"}),
    "RotateRight": (set(), {"degrees"}),
    "LookUp": (set(), {"degrees"}),
    "LookDown": (set(), {"degrees"}),
    "Teleport": (set(), {"position", "rotation", "horizon", "standing", "forceAction"}),
    "GetReachablePositions": (set(), {"gridSize"}),
    "GetShortestPath": ({"objectType", "position"}, {"allowedError", "rotation"}),
    "GetShortestPathToPoint": ({"position", "target"}, {"allowedError"}),
}


class StandIn:
    """One process, were it the real one. Actions that fail say so and change nothing."""

    started: ClassVar[list[StandIn]] = []

    def __init__(self, **settings: Any) -> None:
        self.settings = settings
        self.calls: list[str] = []
        self.stopped = False
        self.x, self.z, self.yaw, self.pitch = 0.0, 0.0, 0.0, 0.0
        StandIn.started.append(self)

    def reset(self, scene: str) -> SimpleNamespace:
        self.scene = scene
        self.calls.append(f"reset {scene}")
        self.x, self.z, self.yaw, self.pitch = 0.0, 0.0, 0.0, 0.0
        if scene not in SCENES:
            return self._event(f"{scene} is not a valid scene")
        return self._event()

    def step(self, action: str, **arguments: Any) -> SimpleNamespace:
        needed, allowed = SIGNATURES[action]
        if not needed <= set(arguments) <= needed | allowed:
            raise ValueError(f"Invalid arguments of {action}: {sorted(arguments)}")
        self.calls.append(action)
        name = f"_{action}"
        return getattr(self, name)(**arguments)

    def stop(self) -> None:
        self.stopped = True

    def _MoveAhead(self, moveMagnitude: float) -> SimpleNamespace:
        angle = math.radians(self.yaw)
        x = self.x + moveMagnitude * math.sin(angle)
        z = self.z + moveMagnitude * math.cos(angle)
        if not self._inside(x, z):
            return self._event("Wall is blocking Agent 0 from moving")
        self.x, self.z = x, z
        return self._event()

    def _RotateLeft(self, degrees: float) -> SimpleNamespace:
        self.yaw = (self.yaw - degrees) % 360
        return self._event()

    def _RotateRight(self, degrees: float) -> SimpleNamespace:
        self.yaw = (self.yaw + degrees) % 360
        return self._event()

    def _LookUp(self, degrees: float) -> SimpleNamespace:
        return self._look(-degrees)

    def _LookDown(self, degrees: float) -> SimpleNamespace:
        return self._look(degrees)

    def _look(self, degrees: float) -> SimpleNamespace:
        if not -30 <= self.pitch + degrees <= 60:
            return self._event("cannot look beyond the limits")
        self.pitch += degrees
        return self._event()

    def _Teleport(
        self, position: dict[str, float], rotation: dict[str, float], horizon: float
    ) -> SimpleNamespace:
        if not self._inside(position["x"], position["z"]):
            return self._event("the target position is not in a room")
        self.x, self.z = position["x"], position["z"]
        self.yaw, self.pitch = rotation["y"], horizon
        return self._event()

    def _GetReachablePositions(self) -> SimpleNamespace:
        line = np.arange(0, SIDE + 0.1, 0.25).tolist()
        return self._event(returned=[_vector((x, HEIGHT, z)) for x in line for z in line])

    def _GetShortestPath(
        self, objectType: str, position: dict[str, float], allowedError: float
    ) -> SimpleNamespace:
        if objectType != "Mug":
            return self._event(f"no {objectType} in the scene")
        start = position["x"], HEIGHT, position["z"]
        nearest = min(MUGS, key=lambda mug: math.dist(_plan(mug), _plan(start)))
        return self._event(returned={"corners": [_vector(start), _vector(nearest, HEIGHT)]})

    def _GetShortestPathToPoint(
        self, position: dict[str, float], target: dict[str, float], allowedError: float
    ) -> SimpleNamespace:
        x, y, z = (target[axis] for axis in "xyz")
        if not self._inside(x, z) or allowedError < 0.1:
            return self._event("no path")
        # Off by a little, as paths on a mesh are.
        corners = [(position["x"], y, position["z"] + 0.05), (x, y, z)]
        return self._event(returned={"corners": [_vector(corner) for corner in corners]})

    @staticmethod
    def _inside(x: float, z: float) -> bool:
        return -1e-6 <= x <= SIDE + 1e-6 and -1e-6 <= z <= SIDE + 1e-6

    def _event(self, error: str = "", returned: Any = None) -> SimpleNamespace:
        height, width = self.settings["height"], self.settings["width"]
        depth = np.full((height, width), SIDE - self.z, np.float32)
        return SimpleNamespace(
            frame=np.full((height, width, 3), round(self.yaw) % 256, np.uint8),
            depth_frame=depth if self.settings["renderDepthImage"] else None,
            metadata={
                "agent": {
                    "position": _vector((self.x, HEIGHT, self.z)),
                    "rotation": {"x": 0.0, "y": self.yaw, "z": 0.0},
                    "cameraHorizon": self.pitch,
                },
                "objects": [self._seen(i, mug) for i, mug in enumerate(MUGS)],
                "lastActionSuccess": not error,
                "errorMessage": error,
                "actionReturn": returned,
                "sceneName": self.scene,
            },
        )

    def _seen(self, number: int, mug: tuple[float, float, float]) -> dict[str, Any]:
        x, z = mug[0] - self.x, mug[2] - self.z
        distance = math.hypot(x, z)
        off = abs((math.degrees(math.atan2(x, z)) - self.yaw + 180) % 360 - 180)
        visible = distance <= self.settings["visibilityDistance"] and off <= 40
        return {
            "objectId": f"Mug|{number}",
            "objectType": "Mug",
            "visible": visible,
            "distance": distance,
        }


def _vector(point: tuple[float, float, float], height: float | None = None) -> dict[str, float]:
    x, y, z = point
    return {"x": x, "y": y if height is None else height, "z": z}


def _plan(point: tuple[float, float, float]) -> tuple[float, float]:
    return point[0], point[2]
