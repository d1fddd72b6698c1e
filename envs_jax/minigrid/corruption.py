"""Experts that are of no use near the goal: those of ADVISOR's corrupt-expert tasks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import expert as experts
from envs_jax.minigrid.samplers.changed import ChangedEpisodes
from envs_jax.minigrid.state import GridState
from envs_jax.minigrid.tasks import GoalState, GoalTask
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, ExpertAction, Outcome
from jaxact.spaces import Discrete

_FAR = jnp.iinfo(jnp.int32).max


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CorruptState(GoalState):
    """Progress of a `CorruptGoalTask`.

    Attributes:
      closest: int32 scalar, the fewest actions from the goal that the agent has been, the present
        included.
      advice: int32 scalar, the first action of a shortest plan from the present state.
      valid: bool scalar, whether there is such a plan.
    """

    closest: jax.Array
    advice: jax.Array
    valid: jax.Array


@dataclass(frozen=True, kw_only=True)
class CorruptGoalTask(GoalTask):
    """`GoalTask`, but its expert acts at random once the agent has been near the goal.

    From the first state from which `within` actions or fewer lead to the goal, to the end of the
    episode, the advice is uniformly random over the actions, also if the agent walks away again.
    Every step is planned, whether or not the expert is asked: the closest so far has to be known.

    Source: Weihs et al. 2021 (https://arxiv.org/abs/2007.12173) and `MiniGridTask.query_expert` of
    AllenAct. AllenAct counts one action more, that of leaving the goal for a common node of
    all goals: its `corrupt_expert_within_actions_of_goal` of 10 is `within` of 9 here.

    Attributes:
      within: the number of actions.
      num_actions: of the environment, to choose from.
    """

    within: int
    num_actions: int

    def step(
        self, task_state: GoalState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[GoalState, Outcome]:
        """Judges one step; see `Task.step`."""
        task_state, outcome = super().step(task_state, before, action, after)
        assert isinstance(task_state, CorruptState)
        return _look(task_state, after, self.height), outcome

    def expert(self, key: jax.Array, task_state: GoalState, state: GridState) -> ExpertAction:
        """Returns the first action of a shortest plan to the goal, or a random one."""
        assert isinstance(task_state, CorruptState)
        random = jax.random.randint(key, (), 0, self.num_actions, jnp.int32)
        is_corrupt = task_state.closest <= self.within
        action = jnp.where(is_corrupt, random, task_state.advice)
        return ExpertAction(action, task_state.valid)


@dataclass(frozen=True)
class CorruptSampler(ChangedEpisodes):
    """The episodes of a sampler, for a `CorruptGoalTask`.

    Attributes:
      height: cells of the grid along y.
    """

    height: int

    def change(self, episode: Episode) -> Episode:
        """Returns the episode with the distance from its goal."""
        parts = {field.name: getattr(episode.task, field.name) for field in fields(GoalState)}
        unplanned = CorruptState(
            **parts, closest=jnp.int32(_FAR), advice=jnp.int32(0), valid=jnp.bool_(False)
        )
        return replace(episode, task=_look(unplanned, episode.environment, self.height))


def _look(task_state: CorruptState, state: GridState, height: int) -> CorruptState:
    """Returns the task's state with the plan that there is from the world as it stands."""
    advice, distance = experts.goal_plan(state, height)
    distance = jnp.where(advice.valid, distance, jnp.int32(_FAR))
    closest = jnp.minimum(task_state.closest, distance)
    return replace(task_state, closest=closest, advice=advice.action, valid=advice.valid)


def corrupt_expert(pomdp: POMDP, within: int) -> POMDP:
    """Returns a grid world with a goal whose expert acts at random once the agent has been near it.

    Args:
      pomdp: the world; its task is a `GoalTask`.
      within: how near, in actions; see `CorruptGoalTask`.

    Raises:
      JaxactError: the world's task is another, its sampler learns, or `within` is negative.
    """
    if type(pomdp.task) is not GoalTask or not isinstance(pomdp.action_space, Discrete):
        name = type(pomdp.task).__name__
        raise JaxactError(f"only a GoalTask's expert can be corrupted, not that of {name}")
    if within < 0:
        raise JaxactError(f"within must not be negative, got {within}")
    task = CorruptGoalTask(
        pomdp.task.width,
        pomdp.task.height,
        pomdp.task.slope,
        within=within,
        num_actions=pomdp.action_space.n,
    )
    return replace(pomdp, task=task, sampler=CorruptSampler(pomdp.sampler, task.height))
