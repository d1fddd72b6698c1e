"""The simulators whose tasks these are: their bodies, cameras, moves, rewards and rules."""

from __future__ import annotations

import math
from dataclasses import dataclass

from envs_jax.houses.camera import Camera
from envs_jax.houses.environment import House
from envs_jax.houses.noise import preset
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.state import Body
from envs_jax.houses.visibility import Sight
from envs_jax.houses.vision import ALLENACT_DEPTH, HABITAT_DEPTH, DepthScale
from jaxact.errors import unknown

_POINT_NAV = ("move_ahead", "rotate_left", "rotate_right", "end")
_OBJECT_NAV = (*_POINT_NAV, "look_up", "look_down")


def vertical_fov(horizontal_fov: float, aspect: float) -> float:
    """Returns the vertical field of view, degrees, of a picture `aspect` times as wide as high."""
    return math.degrees(2 * math.atan(math.tan(math.radians(horizontal_fov) / 2) / aspect))


@dataclass(frozen=True)
class Platform:
    """What a simulator's tasks have in common, and the numbers in which its two tasks differ.

    Attributes:
      body: of the agent.
      turn: degrees.
      collision: what becomes of a move into something, see `House`.
      noise: name of a preset, see `noise.preset`, for who asks for noise.
      horizontal_fov: degrees.
      aspect: the simulator's picture's width by its height. As AllenAct does, pictures are squeezed
        into the resolution asked for.
      depth: how depths become readings.
      clockwise: whether the point goal's angle grows clockwise (Habitat) or not (AllenAct).
      point_radius: metres from the goal within which PointNav is to end.
      strict: whether it is not enough to be exactly that far.
      success_reward: of both tasks.
      failure_reward: for ending elsewhere, of ObjectNav.
      refusal_penalty: of ObjectNav.
      sight_distance: metres at which ObjectNav's objects are visible.
      rule: what success is in ObjectNav.
      object_pitch: degrees that the camera looks down when ObjectNav begins.
      horizon: steps.
    """

    body: Body
    turn: float
    collision: str
    noise: str
    horizontal_fov: float
    aspect: float
    depth: DepthScale
    clockwise: bool
    point_radius: float
    strict: bool
    success_reward: float
    failure_reward: float
    refusal_penalty: float
    sight_distance: float
    rule: str
    object_pitch: float
    horizon: int = 500

    def camera(self, resolution: int) -> Camera:
        """Returns a camera of `resolution` × `resolution` pixels."""
        vertical = vertical_fov(self.horizontal_fov, self.aspect)
        return Camera(resolution, resolution, vertical, self.horizontal_fov)

    def house(self, task: str, noisy: bool) -> House:
        """Returns the dynamics for "point_nav" or "object_nav"."""
        actions = _POINT_NAV if task == "point_nav" else _OBJECT_NAV
        noise = preset(self.noise) if noisy else None
        return House(
            self.body, actions, turn=self.turn, collision=self.collision, noise=noise
        )

    def point_nav(self, house: House) -> PointNav:
        """Returns the task of going to a point."""
        return PointNav(
            house, self.point_radius, self.strict, success_reward=self.success_reward
        )

    def object_nav(self, house: House) -> ObjectNav:
        """Returns the task of finding an object."""
        vertical = vertical_fov(self.horizontal_fov, self.aspect)
        return ObjectNav(
            house,
            sight=Sight(vertical, self.aspect, self.sight_distance),
            rule=self.rule,
            refusal_penalty=self.refusal_penalty,
            success_reward=self.success_reward,
            failure_reward=self.failure_reward,
        )


# AllenAct's RoboTHOR tasks and the RoboTHOR challenge of 2021; iTHOR's of AllenAct's tutorials;
# habitat-lab's PointNav and ObjectNav.
PLATFORMS = {
    "robothor": Platform(
        body=Body(radius=0.175, height=0.9, camera_height=0.87),
        turn=30.0,
        collision="fail",
        noise="ai2thor_locobot",
        horizontal_fov=79.0,
        aspect=4 / 3,
        depth=ALLENACT_DEPTH,
        clockwise=False,
        point_radius=0.2,
        strict=False,
        success_reward=10.0,
        failure_reward=0.0,
        refusal_penalty=0.0,
        sight_distance=1.0,
        rule="visible",
        object_pitch=30.0,
    ),
    "ithor": Platform(
        body=Body(radius=0.2, height=1.8, camera_height=1.576),
        turn=90.0,
        collision="fail",
        noise="ai2thor_locobot",
        horizontal_fov=90.0,
        aspect=1.0,
        depth=ALLENACT_DEPTH,
        clockwise=False,
        point_radius=0.2,
        strict=False,
        success_reward=1.0,
        failure_reward=-1.0,
        refusal_penalty=-0.03,
        sight_distance=1.25,
        rule="visible",
        object_pitch=30.0,
    ),
    "habitat": Platform(
        body=Body(radius=0.1, height=1.5, camera_height=1.25),
        turn=10.0,
        collision="slide",
        noise="pyrobot_locobot_ilqr",
        horizontal_fov=90.0,
        aspect=1.0,
        depth=HABITAT_DEPTH,
        clockwise=True,
        point_radius=0.2,
        strict=True,
        success_reward=2.5,
        failure_reward=0.0,
        refusal_penalty=0.0,
        sight_distance=1.0,
        rule="view_point",
        object_pitch=0.0,
    ),
}


def platform(name: str) -> Platform:
    """Returns a simulator's numbers.

    Raises:
      JaxactError: there is no such platform; the message names the nearest.
    """
    if name not in PLATFORMS:
        raise unknown("platform", name, PLATFORMS)
    return PLATFORMS[name]
