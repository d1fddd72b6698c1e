"""What every navigation task keeps account of: how far it is, was, and has been walked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.houses import metrics
from envs_jax.houses.collision import obstacles
from envs_jax.houses.geodesic import GoalField, distance, shortest
from envs_jax.houses.state import Body, HouseState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Journey:
    """Progress towards the nearest of some goals.

    Attributes:
      field: how far the goals are, in the house as it stood at the start.
      start_distance: float32 scalar, geodesic metres at the start; infinite if there was no way.
      distance: float32 scalar, geodesic metres now.
      walked: float32 scalar, metres.
      nearest: float32 scalar, the least of the distances so far.
    """

    field: GoalField
    start_distance: jax.Array
    distance: jax.Array
    walked: jax.Array
    nearest: jax.Array


def begin(field: GoalField, state: HouseState, body: Body) -> Journey:
    """Returns the journey of an agent that is about to set out.

    Args:
      field: how far the goals are, see `geodesic.goal_field`.
      state: of the agent and the house.
      body: of the agent.
    """
    boxes = obstacles(state.scene.boxes, body)
    metres = distance(field, boxes, body.radius, state.position)[0]
    start = shortest(field, boxes, body.radius, state.position)
    return Journey(field, start, metres, jnp.float32(0), metres)


def advance(journey: Journey, body: Body, before: HouseState, after: HouseState) -> Journey:
    """Returns the journey after a step from `before` to `after`."""
    boxes = obstacles(after.scene.boxes, body)
    metres, _ = distance(journey.field, boxes, body.radius, after.position)
    walked = journey.walked + moved(before, after)
    nearest = jnp.minimum(journey.nearest, metres)
    return replace(journey, distance=metres, walked=walked, nearest=nearest)


def moved(before: HouseState, after: HouseState) -> jax.Array:
    """Returns the float32 metres from where an agent was to where it is."""
    return jnp.sqrt(jnp.sum((after.position - before.position) ** 2))


def approach(before: Journey, after: Journey) -> jax.Array:
    """Returns the float32 metres that the goal has come nearer; 0 if there is none."""
    gain = before.distance - after.distance
    return jnp.where(jnp.isfinite(gain), gain, 0)


def report(journey: Journey, success: jax.Array) -> dict[str, jax.Array]:
    """Returns the task metrics of a journey, were it over."""
    shortest, walked = journey.start_distance, journey.walked
    return {
        "spl": metrics.spl(success, shortest, walked),
        "soft_spl": metrics.soft_spl(journey.distance, shortest, walked),
        "distance_to_goal": journey.distance,
        "path_length": walked,
    }


def refused(before: HouseState, after: HouseState) -> jax.Array:
    """Returns a bool scalar: whether an action was stopped or changed nothing that one can see.

    That is how AI2-THOR's failed actions show; "end" changes nothing either.
    """
    pose = (before.position != after.position).any() | (before.yaw != after.yaw)
    hands = (before.held != after.held) | jnp.any(before.scene.opened != after.scene.opened)
    return after.collided | ~(pose | hands | (before.pitch != after.pitch))
