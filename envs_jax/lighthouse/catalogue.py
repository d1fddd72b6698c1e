"""How a lighthouse is put together."""

from __future__ import annotations

from envs_jax.lighthouse.environment import Lighthouse
from envs_jax.lighthouse.sampler import AnyCorner
from envs_jax.lighthouse.sensors import CornerSensor, DesignSensor
from envs_jax.lighthouse.tasks import FindGoal
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Sensor


def lighthouse(
    dim: int = 2,
    radius: int = 15,
    view_radius: int = 1,
    expert_view_radius: int = 15,
    max_steps: int = 1000,
    observation: str = "design",
    degree: int | None = None,
) -> POMDP:
    """Builds a lighthouse; by default that of ADVISOR's experiments.

    Args:
      dim: 1 for a line, 2 for a square.
      radius: cells from the centre to the border.
      view_radius: how far the agent sees.
      expert_view_radius: how far its expert sees.
      max_steps: after which time is up.
      observation: "corners", what `CornerSensor` reads; "design", what `DesignSensor` reads.
      degree: of the design; by default it is a table.

    Raises:
      JaxactError: no such observation, or a number out of its bounds.
    """
    if dim not in (1, 2):
        raise JaxactError(f"dim must be 1 or 2, got {dim!r}")
    if radius < 1 or max_steps < 1:
        raise JaxactError(f"radius and max_steps must be positive, got {radius} and {max_steps}")
    if min(view_radius, expert_view_radius) < 0:
        raise JaxactError(f"views must not be negative, got {view_radius} and {expert_view_radius}")
    if degree is not None and degree < 1:
        raise JaxactError(f"degree must be at least 1, got {degree}")
    sensors: dict[str, Sensor] = {
        "corners": CornerSensor(dim, radius, view_radius),
        "design": DesignSensor(dim, radius, view_radius, degree),
    }
    if observation not in sensors:
        raise unknown("observation", str(observation), sensors)
    return POMDP(
        Lighthouse(dim, radius),
        FindGoal(radius, expert_view_radius),
        AnyCorner(dim, radius, max_steps),
        {observation: sensors[observation]},
    )
