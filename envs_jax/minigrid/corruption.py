"""Experts that are of no use near the goal: those of ADVISOR's corrupt-expert tasks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import expert as experts
from envs_jax.minigrid import planner
from envs_jax.minigrid.environment import FORWARD, LEFT, RIGHT
from envs_jax.minigrid.guide import Guide, holds
from envs_jax.minigrid.samplers.changed import ChangedEpisodes
from envs_jax.minigrid.samplers.door_key import DoorKeySampler
from envs_jax.minigrid.samplers.locked_room import LockedRoomSampler
from envs_jax.minigrid.samplers.multi_room import MultiRoomSampler
from envs_jax.minigrid.state import GridState
from envs_jax.minigrid.tasks import GoalState, GoalTask
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, ExpertAction, Outcome
from jaxact.spaces import Discrete

# In their worlds the ways to the goal change as doors open.
_WITH_DOORS = (DoorKeySampler, LockedRoomSampler, MultiRoomSampler)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CorruptState(GoalState):
    """Progress of a `CorruptGoalTask`.

    Attributes:
      guide: the way to the goal from everywhere, the same throughout an episode.
      was_near: bool scalar, whether the agent has been near the goal, the present included.
    """

    guide: Guide
    was_near: jax.Array


@dataclass(frozen=True, kw_only=True)
class CorruptGoalTask(GoalTask):
    """`GoalTask`, but its expert acts at random once the agent has been near the goal.

    From the first state from which `within` actions or fewer lead to the goal, to the end of the
    episode, the advice is uniformly random over the actions, also if the agent walks away again.
    It is for worlds in which nothing moves and nothing opens: all ways are planned as an episode
    begins, past everything but bare floor and doors that stand open, and looked up from then on.

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
        return _look(task_state, after), outcome

    def expert(self, key: jax.Array, task_state: GoalState, state: GridState) -> ExpertAction:
        """Returns the first action of a shortest plan to the goal, or a random one."""
        assert isinstance(task_state, CorruptState)
        random = jax.random.randint(key, (), 0, self.num_actions, jnp.int32)
        guide, pose = task_state.guide, (state.position, state.direction)
        turn = jnp.where(holds(guide.right, *pose), RIGHT, FORWARD)
        planned = jnp.where(holds(guide.left, *pose), LEFT, turn)
        action = jnp.where(task_state.was_near, random, planned.astype(jnp.int32))
        return ExpertAction(action, planner.contains(guide.reached, state.position))


@dataclass(frozen=True)
class CorruptSampler(ChangedEpisodes):
    """The episodes of a sampler, for a `CorruptGoalTask`.

    Attributes:
      within: that of the task.
    """

    within: int

    def change(self, episode: Episode) -> Episode:
        """Returns the episode with the ways to its goal."""
        parts = {field.name: getattr(episode.task, field.name) for field in fields(GoalState)}
        # A plan ends in front of the goal, one action from it.
        guide = experts.goal_guide(episode.environment, near=self.within - 1)
        unplaced = CorruptState(**parts, guide=guide, was_near=jnp.bool_(False))
        return replace(episode, task=_look(unplaced, episode.environment))


def _look(task_state: CorruptState, state: GridState) -> CorruptState:
    """Returns the task's state once the agent has got to where it is."""
    is_near = holds(task_state.guide.near, state.position, state.direction)
    return replace(task_state, was_near=task_state.was_near | is_near)


def corrupt_expert(pomdp: POMDP, within: int) -> POMDP:
    """Returns a grid world with a goal whose expert acts at random once the agent has been near it.

    Args:
      pomdp: the world; its task is a `GoalTask`, and nothing in it moves or opens.
      within: how near, in actions; see `CorruptGoalTask`.

    Raises:
      JaxactError: the world's task is another, there are doors in it, its sampler learns, or
        `within` is negative.
    """
    if type(pomdp.task) is not GoalTask or not isinstance(pomdp.action_space, Discrete):
        name = type(pomdp.task).__name__
        raise JaxactError(f"only a GoalTask's expert can be corrupted, not that of {name}")
    if isinstance(pomdp.sampler, _WITH_DOORS):
        raise JaxactError(
            f"the worlds of {type(pomdp.sampler).__name__} have doors, but a corrupt expert plans "
            "all ways as an episode begins; choose one without, such as a crossing"
        )
    if within < 0:
        raise JaxactError(f"within must not be negative, got {within}")
    task = CorruptGoalTask(
        pomdp.task.width,
        pomdp.task.height,
        pomdp.task.slope,
        within=within,
        num_actions=pomdp.action_space.n,
    )
    return replace(pomdp, task=task, sampler=CorruptSampler(pomdp.sampler, within))
