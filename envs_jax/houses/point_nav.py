"""PointNav: go to a point that is told, and say so."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.houses import journey as journeys
from envs_jax.houses.environment import House, check_house
from envs_jax.houses.expert import walk
from envs_jax.houses.geodesic import GoalField
from envs_jax.houses.journey import Journey
from envs_jax.houses.state import HouseState
from jaxact.pomdp import POMDP, ExpertAction, Outcome, Task


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PointNavState:
    """Progress of a `PointNav`.

    Attributes:
      goal: float32 [2], a plan.
      start: float32 [3], the plan and the yaw at which the agent set out.
      journey: how far it is.
    """

    goal: jax.Array
    start: jax.Array
    journey: Journey


@dataclass(frozen=True)
class PointNav(Task):
    """End within some geodesic distance of the goal; whatever the place, "end" ends the episode.

    Ending at once is an attempt like any other, see `metrics` for what it scores.

    Sources: AllenAct's `PointNavTask` (success within 0.2 m inclusive, reward 10) and habitat-lab's
    (strictly within, 2.5).

    Attributes:
      house: the dynamics: its body, its actions, of which one is "end", and what the expert does.
      radius: metres from the goal within which to end.
      strict: whether it is not enough to be exactly that far.
      step_penalty: the reward, a negative one, of each step.
      shaping: reward for each metre that the goal comes nearer.
      success_reward: for ending near the goal.
      failure_reward: for ending elsewhere.
    """

    house: House
    radius: float = 0.2
    strict: bool = False
    step_penalty: float = -0.01
    shaping: float = 1.0
    success_reward: float = 10.0
    failure_reward: float = 0.0

    def start(self, field: GoalField, state: HouseState, goal: jax.Array) -> PointNavState:
        """Returns the first state of an episode.

        Args:
          field: how far the goal is, from `geodesic.goal_field`.
          state: where the agent begins, from `house.start(scene, position, yaw, pitch)`.
          goal: float32 [2], a plan.
        """
        goal = jnp.asarray(goal, jnp.float32)
        journey = journeys.begin(field, state, self.house.body)
        start = jnp.concatenate([state.position, state.yaw[None]])
        return PointNavState(goal, start, journey)

    def step(
        self,
        task_state: PointNavState,
        before: HouseState,
        action: jax.Array,
        after: HouseState,
    ) -> tuple[PointNavState, Outcome]:
        """Judges one step; see `Task.step`."""
        old = task_state.journey
        new = journeys.advance(old, self.house.body, before, after)
        ended = jnp.asarray(action, jnp.int32) == self.house.actions.index("end")
        success = ended & self.is_near(new)
        zero = jnp.float32(0)
        end_reward = jnp.where(
            success, self._number("success_reward"), self._number("failure_reward")
        )
        return PointNavState(task_state.goal, task_state.start, new), Outcome(
            reward={
                "step": self._number("step_penalty"),
                "shaping": self._number("shaping") * journeys.approach(old, new),
                "success": jnp.where(ended, end_reward, zero),
            },
            success={"goal": success},
            terminated=ended,
            metrics=journeys.report(new, success),
        )

    def expert(self, key: jax.Array, task_state: PointNavState, state: HouseState) -> ExpertAction:
        """Returns the first action of a short way to the goal, or "end" there."""
        del key
        journey = task_state.journey
        action = walk(self.house, journey, state, self._number("radius") - 1e-3)
        end = self.house.actions.index("end")
        action = jnp.where(self.is_near(task_state.journey), end, action)
        return ExpertAction(action.astype(jnp.int32), jnp.bool_(True))

    def is_near(self, journey: Journey) -> jax.Array:
        """Returns a bool scalar: whether to end here is success."""
        radius = self._number("radius")
        near = journey.distance < radius if self.strict else journey.distance <= radius
        return near & jnp.isfinite(journey.start_distance)

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment with other dynamics than `house`."""
        check_house("task.house", self.house, pomdp)

    def _number(self, name: str) -> jax.Array:
        return jnp.asarray(getattr(self, name), jnp.float32)
