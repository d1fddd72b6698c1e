"""The task of a lighthouse: find the corner that is the goal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.lighthouse.environment import LighthouseState, corners
from envs_jax.lighthouse.expert import search
from envs_jax.lighthouse.views import look
from jaxact.pomdp import ExpertAction, Outcome, Task


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchState:
    """Progress of a `FindGoal`.

    Attributes:
      goal: int32 scalar, the goal's corner, by its place in `corners`.
      steps: int32 scalar, steps taken so far.
      max_steps: int32 scalar, after which time is up.
    """

    goal: jax.Array
    steps: jax.Array
    max_steps: jax.Array


@dataclass(frozen=True)
class FindGoal(Task):
    """Go to the corner that is the goal.

    A step costs −`step_penalty`, and finding the goal earns `goal_reward`. When time is up, the
    step costs what endless walking would, discounted: as this stands for all that would follow, the
    task then ends, and nothing is bootstrapped.

    Attributes:
      radius: of the world.
      expert_view_radius: how far the expert sees.
      step_penalty: the reward, a negative one, of each step.
      goal_reward: added to it on the goal.
      discount: of endless walking.
    """

    radius: int
    expert_view_radius: int
    step_penalty: float = -0.01
    goal_reward: float = 1.0
    discount: float = 0.99

    def step(
        self,
        task_state: SearchState,
        before: LighthouseState,
        action: jax.Array,
        after: LighthouseState,
    ) -> tuple[SearchState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        task_state = replace(task_state, steps=task_state.steps + 1)
        dim = after.position.shape[0]
        goal = self.radius * jnp.asarray(corners(dim))[task_state.goal]
        found = jnp.all(after.position == goal)
        late = ~found & (task_state.steps >= task_state.max_steps)
        penalty = jnp.asarray(self.step_penalty, jnp.float32)
        forever = penalty / (1 - jnp.asarray(self.discount, jnp.float32))
        zero = jnp.float32(0)
        return task_state, Outcome(
            reward={
                "step": jnp.where(late, zero, penalty),
                "success": jnp.where(found, jnp.asarray(self.goal_reward, jnp.float32), zero),
                "time_out": jnp.where(late, forever, zero),
            },
            success={"goal": found},
            terminated=found | late,
            metrics={},
        )

    def expert(
        self, key: jax.Array, task_state: SearchState, state: LighthouseState
    ) -> ExpertAction:
        """Returns the next step of a shortest search, for one who sees `expert_view_radius` far."""
        del key
        known, border = look(state, task_state.goal, self.radius, self.expert_view_radius)
        return ExpertAction(search(known, border, state.last_action), jnp.bool_(True))
