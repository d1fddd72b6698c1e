"""Which actions of two agents go together: FurnMove's and FurnLift's coordination matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Agents, Box

# What a pair of actions is: at odds; each agent's own business; or one action of both together.
UNCOORDINATED, INDIVIDUAL, TOGETHER = range(3)

MOVE_ACTIONS = (
    *("move_ahead", "rotate_left", "rotate_right", "pass"),
    *(f"move_agents_{to}_with_object" for to in ("ahead", "right", "back", "left")),
    "rotate_object_right",
    *(f"move_object_{to}" for to in ("ahead", "right", "back", "left")),
)
LIFT_ACTIONS = ("move_ahead", "rotate_left", "rotate_right", "pass", "pickup")
# The first actions of both are each agent's own, the last of these is to pass.
MOVE_AHEAD, ROTATE_LEFT, ROTATE_RIGHT, PASS = range(4)
# The first of the four that carry the object along, of those that push it, and what turns it.
CARRY, TURN_OBJECT, PUSH = 4, 8, 9
PICKUP = 4


def _move_matrix(first: int, second: int, one_passes: bool) -> np.ndarray:
    matrix = np.full((len(MOVE_ACTIONS),) * 2, UNCOORDINATED, np.uint8)
    matrix[:CARRY, :CARRY] = UNCOORDINATED if one_passes else INDIVIDUAL
    matrix[PASS, :CARRY] = matrix[:CARRY, PASS] = INDIVIDUAL
    for start in (CARRY, PUSH):
        for i in range(4):
            # The same direction of the map, as the other one sees it.
            matrix[start + i, start + (i + first - second) % 4] = TOGETHER
    matrix[TURN_OBJECT, TURN_OBJECT] = TOGETHER
    return matrix


def move_matrices(one_passes: bool) -> np.ndarray:
    """Returns what each pair of FurnMove's actions is, uint8 [4, 4, 13, 13] by the agents' yaws.

    Actions that need both go together if they are of one kind and, as each agent is turned, of one
    direction of the map.

    Args:
      one_passes: whether an agent's own actions count as coordinated only if the other (or itself)
        passes.
    """
    return np.stack(
        [np.stack([_move_matrix(i, j, one_passes) for j in range(4)]) for i in range(4)]
    )


def lift_matrices() -> np.ndarray:
    """Returns what each pair of FurnLift's actions is, uint8 [4, 4, 5, 5] as for FurnMove's."""
    matrix = np.full((len(LIFT_ACTIONS),) * 2, UNCOORDINATED, np.uint8)
    matrix[:PICKUP, :PICKUP] = INDIVIDUAL
    matrix[PICKUP, PICKUP] = TOGETHER
    return np.broadcast_to(matrix, (4, 4, *matrix.shape))


class Turned(Protocol):
    """A world whose pairs of actions are what they are by the agents' yaws."""

    @property
    def matrices(self) -> np.ndarray:
        """What each pair of actions is, uint8 [4, 4, n, n]; the states have `yaw`, int32 [2]."""
        ...


@dataclass(frozen=True)
class Coordination(Sensor):
    """What each pair of actions would be, uint8 [2, n, n], the same for both agents.

    0 is uncoordinated, 1 individual and 2 together. It is for losses, see `jaxact.losses.Cordial`;
    policies need not see it.

    Attributes:
      environment: whose actions they are.
    """

    environment: Turned

    @property
    def space(self) -> Agents:
        """Codes from 0 to 2."""
        return Agents(Box(0, 2, self.environment.matrices.shape[2:], "uint8"), 2)

    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the matrix for each agent."""
        del task_state
        matrix = jnp.asarray(self.environment.matrices)[state.yaw[0], state.yaw[1]]
        return jnp.broadcast_to(matrix, (2, *matrix.shape))
