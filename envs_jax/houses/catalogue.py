"""How navigation in houses is put together, and its ids."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from envs_jax.houses.bank import GeneratedScenes, Scenes
from envs_jax.houses.generator import Apartment, Floor, Room, Style
from envs_jax.houses.platforms import Platform, platform
from envs_jax.houses.rerendering import ViewpointSensor
from envs_jax.houses.samplers import ObjectNavSampler, PointNavSampler, Starts
from envs_jax.houses.sensors import (
    CollisionSensor,
    LastActionSensor,
    ObjectGoalSensor,
    PointGoalSensor,
)
from envs_jax.houses.vision import DepthSensor, RGBSensor, SemanticSensor
from envs_jax.registry import register
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Sensor

TASKS = ("point_nav", "object_nav")
STYLES: dict[str, Style] = {"room": Room(), "apartment": Apartment(), "floor": Floor()}
# Which houses a platform's are most like.
_USUAL = {"robothor": "apartment", "ithor": "room", "habitat": "floor"}
_OBSERVATIONS = ("depth", "rgb", "semantic", "viewpoint", "collision", "last_action")


def navigation(
    platform_name: str = "robothor",
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
      platform_name: "robothor", "ithor" or "habitat".
      task: "point_nav" or "object_nav".
      observation: what is seen beside the goal, out of "depth", "rgb", "semantic", "viewpoint" (for
        frames that are rendered again, see `Rerendered`), "collision" and "last_action"; nothing
        for a blind agent.
      resolution: pixels along each edge of a frame.
      style: "room", "apartment" or "floor"; by default what is most like the platform's own.
      houses: how many there are to train in; evaluation is in others, never trained in.
      noisy: whether moves and turns err as the platform's robot does.
      scenes: houses from elsewhere, in place of `style` and `houses`.

    Returns:
      The POMDP. Its observation has "point_goal" (distance and angle) or "object_goal" (an index
      into `categories.NAMES`), and what was asked for.

    Raises:
      JaxactError: no such platform, task, style or observation, or a number out of its bounds.
    """
    numbers = platform(platform_name)
    style = style or _USUAL[platform_name]
    if task not in TASKS:
        raise unknown("task", task, TASKS)
    if style not in STYLES:
        raise unknown("style of houses", style, STYLES)
    if houses < 1:
        raise JaxactError(f"houses must be at least 1, got {houses!r}")
    if scenes is None:
        scenes = GeneratedScenes(STYLES[style], houses)
    house = numbers.house(task, noisy)
    sensors = _sensors(numbers, observation, resolution, scenes, len(house.actions))
    horizon = numbers.horizon
    if task == "point_nav":
        goal: Sensor = PointGoalSensor(clockwise=numbers.clockwise)
        point_nav = numbers.point_nav(house)
        sampler = PointNavSampler(point_nav, scenes, Starts(), horizon)
        return POMDP(house, point_nav, sampler, {"point_goal": goal, **sensors})
    object_nav = numbers.object_nav(house)
    starts = Starts(least=0.0, pitch=numbers.object_pitch)
    targets = ObjectNavSampler(object_nav, scenes, starts=starts, horizon=horizon)
    return POMDP(house, object_nav, targets, {"object_goal": ObjectGoalSensor(), **sensors})
