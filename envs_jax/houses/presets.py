"""The dynamics and tasks of AI2-THOR, RoboTHOR and Habitat as they are commonly set.

Sources: AllenAct's configurations and, for habitat, habitat-lab's of the 2020 challenges.
"""

from __future__ import annotations

from envs_jax.houses.environment import House
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.state import Body
from envs_jax.houses.visibility import ROBOTHOR_SIGHT, Sight
from jaxact.errors import unknown

# RoboTHOR's LoCoBot, iTHOR's agent and Habitat's cylinder.
LOCOBOT = Body(radius=0.175, height=0.9, camera_height=0.87)
ITHOR_BODY = Body(radius=0.2, height=1.8, camera_height=1.576)
HABITAT_BODY = Body(radius=0.1, height=1.5, camera_height=1.25)
HABITAT_LOCOBOT = Body(radius=0.18, height=0.88, camera_height=0.88)

_WALK = ("move_ahead", "rotate_left", "rotate_right")
_THOR_POINT = (*_WALK, "end")
_THOR_OBJECT = (*_WALK, "look_down", "look_up", "end")
_HABITAT_POINT = ("end", *_WALK)
_HABITAT_OBJECT = ("end", *_WALK, "look_up", "look_down")

_ITHOR_SIGHT = Sight(field_of_view=90.0, aspect=1.0, distance=1.25)

POINT_NAV = {
    "ithor": PointNav(House(ITHOR_BODY, _THOR_POINT)),
    "robothor": PointNav(House(LOCOBOT, _THOR_POINT)),
    "habitat": PointNav(
        House(HABITAT_BODY, _HABITAT_POINT, turn=10.0, collision="slide"),
        strict=True,
        success_reward=2.5,
    ),
}
OBJECT_NAV = {
    "ithor": ObjectNav(
        House(ITHOR_BODY, _THOR_OBJECT, turn=90.0),
        _ITHOR_SIGHT,
        refusal_penalty=-0.03,
        shaping=0.0,
        success_reward=1.0,
        failure_reward=-1.0,
    ),
    "robothor": ObjectNav(House(LOCOBOT, _THOR_OBJECT), ROBOTHOR_SIGHT),
    "habitat": ObjectNav(
        House(HABITAT_LOCOBOT, _HABITAT_OBJECT, collision="slide"),
        ROBOTHOR_SIGHT,
        rule="view_point",
    ),
}


def point_nav(name: str) -> PointNav:
    """Returns a PointNav task, and with it its `house`: "ithor", "robothor" or "habitat".

    Raises:
      JaxactError: there is no such preset; the message names the nearest.
    """
    if name not in POINT_NAV:
        raise unknown("preset of PointNav", name, POINT_NAV)
    return POINT_NAV[name]


def object_nav(name: str) -> ObjectNav:
    """Returns an ObjectNav task, and with it its `house`: "ithor", "robothor" or "habitat".

    Raises:
      JaxactError: there is no such preset; the message names the nearest.
    """
    if name not in OBJECT_NAV:
        raise unknown("preset of ObjectNav", name, OBJECT_NAV)
    return OBJECT_NAV[name]
