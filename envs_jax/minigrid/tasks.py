"""The tasks of grid worlds: reach the goal square, or follow an instruction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import expert as experts
from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import DROP, FORWARD, at_index, front_index, heading
from envs_jax.minigrid.state import GridState
from jaxact.pomdp import ExpertAction, Outcome, Task

REWARD_SLOPE = 0.9


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GoalState:
    """Progress of a `GoalTask`.

    Attributes:
      steps: int32 scalar, steps taken so far.
      max_steps: int32 scalar, the horizon that rewards are measured by.
      mission: int32[MISSION_LENGTH] tokens.
    """

    steps: jax.Array
    max_steps: jax.Array
    mission: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InstructionState:
    """Progress of an `InstructionTask`.

    An instruction speaks of objects by descriptions. Description i tracks the objects whose marks
    have bit i set; where it believes them to be is looked up anew only when the agent drops
    something, or tries to, so a belief can be stale.

    Attributes:
      steps: int32 scalar, steps taken so far.
      max_steps: int32 scalar, the horizon that rewards are measured by.
      mission: int32[MISSION_LENGTH] tokens.
      ghosts: uint32[descriptions, height], bit x of row y: description i errs about cell (x, y).
        In play such a cell is one that a tracked object has left: it is still believed there.
    """

    steps: jax.Array
    max_steps: jax.Array
    mission: jax.Array
    ghosts: jax.Array


def success_reward(slope: float, steps: jax.Array, max_steps: jax.Array) -> jax.Array:
    """Returns MiniGrid's reward of success, 1 − `slope` · steps / max_steps."""
    share = steps.astype(jnp.float32) / max_steps.astype(jnp.float32)
    return 1 - jnp.asarray(slope, jnp.float32) * share


def entered(
    before: GridState, action: jax.Array, after: GridState, height: int
) -> tuple[jax.Array, jax.Array]:
    """Returns two bools: whether the step led onto a goal square, and onto lava.

    Neither ever changes, so what lay in front of the agent is read from the state after the step:
    the state before it can then be overwritten in place.
    """
    kind = at_index(after.tiles, front_index(before, height)) & tiles.TYPE_MASK
    return (action == FORWARD) & (kind == tiles.GOAL), (action == FORWARD) & (kind == tiles.LAVA)


@dataclass(frozen=True)
class GoalTask(Task):
    """Reach the goal square; lava ends the episode without reward.

    The reward of success is 1 − `slope` · steps / max_steps, as in MiniGrid.
    """

    width: int
    height: int
    slope: float = REWARD_SLOPE

    def step(
        self, task_state: GoalState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[GoalState, Outcome]:
        """Judges one step; see `Task.step`."""
        task_state = replace(task_state, steps=task_state.steps + 1)
        goal, lava = entered(before, action, after, self.height)
        reward = success_reward(self.slope, task_state.steps, task_state.max_steps)
        return task_state, Outcome(
            reward={"success": jnp.where(goal, reward, jnp.float32(0))},
            success={"goal": goal},
            terminated=goal | lava,
            metrics={},
        )

    def expert(self, key: jax.Array, task_state: GoalState, state: GridState) -> ExpertAction:
        """Returns the first action of a shortest plan to the goal square."""
        return experts.goal_expert(key, task_state, state, self.width, self.height)


@dataclass(frozen=True)
class InstructionTask(Task):
    """Follow a BabyAI instruction: go to an object that a description fits.

    It is done when the agent faces a cell where the description believes such an object to be,
    whatever the action was. The reward is `GoalTask`'s. Source: `GoToInstr` and `RoomGridLevel` of
    minigrid 3.2.0.
    """

    width: int
    height: int
    slope: float = REWARD_SLOPE

    def step(
        self, task_state: InstructionState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[InstructionState, Outcome]:
        """Judges one step; see `Task.step`."""
        ghosts = self._believe(task_state.ghosts, before, action, after)
        task_state = replace(task_state, steps=task_state.steps + 1, ghosts=ghosts)
        faced = self._tracked(after, front_index(after, self.height))
        done = (faced ^ self._pick(ghosts, after)) == 1
        # No level has a goal square or lava, but worlds are free to.
        goal, lava = entered(before, action, after, self.height)
        reward = success_reward(self.slope, task_state.steps, task_state.max_steps)
        return task_state, Outcome(
            reward={"success": jnp.where(done | goal, reward, jnp.float32(0))},
            success={"instruction": done},
            terminated=done | goal | lava,
            metrics={},
        )

    def expert(
        self, key: jax.Array, task_state: InstructionState, state: GridState
    ) -> ExpertAction:
        """Returns the first action of a shortest plan to face the nearest described object."""
        return experts.goto_expert(key, task_state, state, self.width, self.height)

    def _tracked(self, state: GridState, cell: jax.Array) -> jax.Array:
        """Returns uint32 0 or 1: whether description 0 tracks what stands in `cell`."""
        return at_index(state.marks, cell).astype(jnp.uint32) & 1

    def _front_bit(self, state: GridState) -> jax.Array:
        """Returns uint32[1, height] with one bit set, that of the cell the agent faces."""
        x, y = state.position + heading(state.direction)
        rows = jnp.arange(self.height, dtype=jnp.int32) == y
        return jnp.where(rows, jnp.uint32(1) << x.astype(jnp.uint32), jnp.uint32(0))[None]

    def _pick(self, ghosts: jax.Array, state: GridState) -> jax.Array:
        """Returns uint32 0 or 1: the bit in `ghosts` of the cell the agent faces."""
        return jnp.any((ghosts & self._front_bit(state)) != 0).astype(jnp.uint32)

    def _believe(
        self, ghosts: jax.Array, before: GridState, action: jax.Array, after: GridState
    ) -> jax.Array:
        """Returns the ghosts after a step: none after a drop action, else one more perhaps."""
        cell = front_index(before, self.height)
        left = self._tracked(before, cell) != self._tracked(after, cell)
        ghosts = jnp.where(left, ghosts ^ self._front_bit(before), ghosts)
        return jnp.where(action == DROP, jnp.uint32(0), ghosts)
