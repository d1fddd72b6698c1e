"""How navigation in houses is put together, and its ids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from envs_jax.houses import presets
from envs_jax.houses.bank import GeneratedScenes, Scenes
from envs_jax.houses.camera import Camera
from envs_jax.houses.environment import House
from envs_jax.houses.generator import APARTMENT, FLOOR, ROOM, Style
from envs_jax.houses.noise import preset as noise_preset
from envs_jax.houses.samplers import ObjectNavSampler, PointNavSampler, Starts
from envs_jax.houses.sensors import (
    CollisionSensor,
    LastActionSensor,
    ObjectGoalSensor,
    PointGoalSensor,
)
from envs_jax.houses.viewpoint import ViewpointSensor
from envs_jax.houses.vision import (
    ALLENACT_DEPTH,
    HABITAT_DEPTH,
    DepthScale,
    DepthSensor,
    GoalMaskSensor,
    RGBSensor,
    SemanticSensor,
)
from envs_jax.registry import register
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Sensor

TASKS = ("point_nav", "object_nav")
STYLES: dict[str, Style] = {"room": ROOM, "apartment": APARTMENT, "floor": FLOOR}
OBSERVATIONS = (
    "depth",
    "rgb",
    "semantic",
    "goal_mask",
    "viewpoint",
    "collision",
    "last_action",
)
_HORIZON = 500
# Corners of a roadmap at most; of 128 houses of each style none had more.
_NODES = {"room": 128, "apartment": 128, "floor": 256}


@dataclass(frozen=True)
class _Platform:
    """What a simulator's tasks have besides dynamics, rewards and rules (those are in `presets`).

    Attributes:
      title: as in its ids.
      horizontal_fov: degrees.
      aspect: the picture's width by its height. As AllenAct does, pictures are squeezed into the
        resolution asked for.
      depth: how depths become readings.
      point_goal: convention of the point goal.
      object_pitch: degrees that the camera looks down when ObjectNav begins.
      noise: preset of moves and turns that err.
      style: what its houses are most like.
    """

    title: str
    horizontal_fov: float
    aspect: float
    depth: DepthScale
    point_goal: str
    object_pitch: float
    noise: str
    style: str

    def camera(self, resolution: int) -> Camera:
        """Returns a camera of `resolution` × `resolution` pixels."""
        right = math.tan(math.radians(self.horizontal_fov) / 2)
        vertical_fov = math.degrees(2 * math.atan(right / self.aspect))
        return Camera(resolution, resolution, vertical_fov, self.horizontal_fov)


_THOR = ("allenact", 30.0, "ai2thor_locobot")
PLATFORMS = {
    "ithor": _Platform("iTHOR", 90.0, 1.0, ALLENACT_DEPTH, *_THOR, "room"),
    "robothor": _Platform("RoboTHOR", 79.0, 4 / 3, ALLENACT_DEPTH, *_THOR, "apartment"),
    "habitat": _Platform(
        "Habitat", 90.0, 1.0, HABITAT_DEPTH, "habitat", 0.0, "pyrobot_locobot_ilqr", "floor"
    ),
}


def navigation(
    platform: str = "robothor",
    task: str = "point_nav",
    *,
    observation: Sequence[str] = ("depth",),
    resolution: int = 64,
    style: str = "",
    houses: int = 128,
    noisy: bool = False,
    scenes: Scenes | None = None,
) -> POMDP:
    """Builds PointNav or ObjectNav as a platform has it.

    Args:
      platform: "robothor", "ithor" or "habitat".
      task: "point_nav" or "object_nav".
      observation: what is sensed beside the goal, out of "depth", "rgb", "semantic", "goal_mask"
        (of ObjectNav), "viewpoint" (for frames that the model renders, see `rerendering`),
        "collision" and "last_action"; nothing for a blind agent.
      resolution: pixels along each edge of a frame.
      style: "room", "apartment" or "floor"; by default what is most like the platform's own.
      houses: how many there are to train in; evaluation is in others, never trained in.
      noisy: whether moves and turns err as the platform's robot does.
      scenes: houses from elsewhere, in place of `style` and `houses`.

    Returns:
      The POMDP. Its observation has "point_goal" (distance and bearing) or "object_goal" (its place
      among RoboTHOR's targets), and what was asked for.

    Raises:
      JaxactError: no such platform, task, style or observation, or a number out of its bounds.
    """
    if platform not in PLATFORMS:
        raise unknown("platform", platform, PLATFORMS)
    if task not in TASKS:
        raise unknown("task", task, TASKS)
    numbers = PLATFORMS[platform]
    style = style or numbers.style
    if style not in STYLES:
        raise unknown("style of houses", style, STYLES)
    if scenes is None:
        scenes = GeneratedScenes(STYLES[style], houses)
    if task == "point_nav":
        if "goal_mask" in observation:
            raise JaxactError(
                "a goal mask shows what object_nav is to find; point_nav's goal is not to be seen: "
                'observe it by "point_goal", which is always there'
            )
        to_point = presets.point_nav(platform)
        to_point = replace(to_point, house=_erring(to_point.house, numbers, noisy))
        seen = _sensors(numbers, to_point.house, observation, resolution, scenes)
        goal = PointGoalSensor(numbers.point_goal)
        points = PointNavSampler(to_point, scenes, Starts(), _HORIZON, _NODES[style])
        return POMDP(to_point.house, to_point, points, {"point_goal": goal, **seen})
    to_object = presets.object_nav(platform)
    to_object = replace(to_object, house=_erring(to_object.house, numbers, noisy))
    if isinstance(scenes, GeneratedScenes):
        longest = max(*scenes.style.long_side, *scenes.style.short_side)
        places = math.ceil(longest / to_object.house.step_size) + 1
        to_object = replace(to_object, places=places)
    seen = _sensors(numbers, to_object.house, observation, resolution, scenes)
    starts = Starts(least=0.0, pitch=numbers.object_pitch)
    objects = ObjectNavSampler(
        to_object, scenes, starts=starts, horizon=_HORIZON, nodes=_NODES[style]
    )
    wanted = ObjectGoalSensor(objects.targets)
    return POMDP(to_object.house, to_object, objects, {"object_goal": wanted, **seen})


def _erring(house: House, platform: _Platform, noisy: bool) -> House:
    return replace(house, noise=noise_preset(platform.noise)) if noisy else house


def _sensors(
    platform: _Platform, house: House, names: Sequence[str], resolution: int, scenes: Scenes
) -> dict[str, Sensor]:
    if resolution < 1:
        raise JaxactError(f"resolution must be at least 1, got {resolution!r}")
    camera, body = platform.camera(resolution), house.body
    makers: dict[str, Any] = {
        "depth": lambda: DepthSensor(camera, body, platform.depth),
        "rgb": lambda: RGBSensor(camera, body),
        "semantic": lambda: SemanticSensor(camera, body),
        "goal_mask": lambda: GoalMaskSensor(camera, body),
        "viewpoint": lambda: ViewpointSensor(scenes.boxes),
        "collision": CollisionSensor,
        "last_action": lambda: LastActionSensor(house),
    }
    for name in names:
        if name not in makers:
            raise unknown("observation", name, OBSERVATIONS)
    return {name: makers[name]() for name in names}


for _name, _platform in PLATFORMS.items():
    register(f"{_platform.title}-PointNav-v0", partial(navigation, _name, "point_nav"))
    register(f"{_platform.title}-ObjectNav-v0", partial(navigation, _name, "object_nav"))
