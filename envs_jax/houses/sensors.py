"""What an agent in a house senses besides pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.houses import categories
from envs_jax.houses.environment import House
from envs_jax.houses.object_nav import ObjectNavState
from envs_jax.houses.point_nav import PointNavState
from envs_jax.houses.scene import forward
from envs_jax.houses.state import HouseState
from jaxact.errors import unknown
from jaxact.pomdp import Sensor
from jaxact.spaces import Box, Discrete

POINT_GOALS = ("allenact", "habitat", "cartesian")


@dataclass(frozen=True)
class GPSCompassSensor(Sensor):
    """Where the agent is seen from where it set out, float32 [4].

    Metres ahead and to the right of the start, and the cosine and sine of the degrees that it has
    turned clockwise since. Moves that err show here: it is the truth, not what was commanded.
    """

    @property
    def space(self) -> Box:
        """Four numbers without bounds."""
        return Box(-math.inf, math.inf, (4,))

    def observe(self, state: HouseState, task_state: PointNavState | ObjectNavState) -> jax.Array:
        """Returns the reading."""
        start = task_state.start
        turned = jnp.deg2rad(state.yaw - start[2])
        place = _seen_from(start[:2], start[2], state.position)
        return jnp.concatenate([place, jnp.stack([jnp.cos(turned), jnp.sin(turned)])])


@dataclass(frozen=True)
class PointGoalSensor(Sensor):
    """Where the goal of PointNav is, float32 [2].

    Attributes:
      convention: "allenact", its distance in metres and its bearing in radians, positive to the
        left; "habitat", the same with the bearing positive to the right (its pointgoal's −φ);
        "cartesian", metres ahead and to the right.
    """

    convention: str = "allenact"

    def __post_init__(self) -> None:
        if self.convention not in POINT_GOALS:
            raise unknown("convention of a point goal", self.convention, POINT_GOALS)

    @property
    def space(self) -> Box:
        """Two numbers without bounds."""
        return Box(-math.inf, math.inf, (2,))

    def observe(self, state: HouseState, task_state: PointNavState) -> jax.Array:
        """Returns the reading."""
        return point_goal(self.convention, state.position, state.yaw, task_state.goal)


@dataclass(frozen=True)
class ObjectGoalSensor(Sensor):
    """What to find, an int32 scalar, by its place among the targets.

    Attributes:
      targets: names of categories.
    """

    targets: tuple[str, ...] = categories.ROBOTHOR_TARGETS

    def __post_init__(self) -> None:
        for name in self.targets:
            categories.index(name)

    @property
    def space(self) -> Discrete:
        """One number for each target."""
        return Discrete(len(self.targets))

    def observe(self, state: HouseState, task_state: ObjectNavState) -> jax.Array:
        """Returns the reading."""
        del state
        table = jnp.array([categories.index(name) for name in self.targets], jnp.int32)
        return jnp.argmax(table == task_state.category).astype(jnp.int32)


@dataclass(frozen=True)
class CollisionSensor(Sensor):
    """Whether the last action was stopped by something, an int32 scalar, 0 or 1."""

    @property
    def space(self) -> Discrete:
        """No or yes."""
        return Discrete(2)

    def observe(self, state: HouseState, task_state: Any) -> jax.Array:
        """Returns the reading."""
        del task_state
        return state.collided.astype(jnp.int32)


@dataclass(frozen=True)
class LastActionSensor(Sensor):
    """The last action, an int32 scalar; before the first, the number of actions."""

    house: House

    @property
    def space(self) -> Discrete:
        """The actions and one more."""
        return Discrete(len(self.house.actions) + 1)

    def observe(self, state: HouseState, task_state: Any) -> jax.Array:
        """Returns the reading."""
        del task_state
        return state.last_action


@dataclass(frozen=True)
class HeadingSensor(Sensor):
    """Where the camera points, float32 [3]: cosine and sine of the yaw, and radians down."""

    @property
    def space(self) -> Box:
        """Three numbers, none beyond a right angle."""
        return Box(-math.pi / 2, math.pi / 2, (3,))

    def observe(self, state: HouseState, task_state: Any) -> jax.Array:
        """Returns the reading."""
        del task_state
        yaw, down = jnp.deg2rad(state.yaw), jnp.deg2rad(state.pitch)
        return jnp.stack([jnp.cos(yaw), jnp.sin(yaw), down])


def point_goal(convention: str, position: jax.Array, yaw: jax.Array, goal: jax.Array) -> jax.Array:
    """Returns where a goal is, float32 [2].

    Args:
      convention: see `PointGoalSensor`.
      position: float32 [2], the plan of the agent.
      yaw: degrees, float32 scalar.
      goal: float32 [2], a plan.
    """
    place = _seen_from(position, yaw, goal)
    if convention == "cartesian":
        return place
    bearing = jnp.arctan2(place[1], place[0])
    bearing = -bearing if convention == "allenact" else bearing
    return jnp.stack([jnp.sqrt(jnp.sum(place**2)), bearing])


def _seen_from(place: jax.Array, yaw: jax.Array, plan: jax.Array) -> jax.Array:
    """Returns the metres ahead and to the right, float32 [2], at which a plan is."""
    ahead, offset = forward(yaw), plan - place
    right = jnp.stack([ahead[1], -ahead[0]])
    return jnp.stack([jnp.sum(offset * ahead), jnp.sum(offset * right)])
