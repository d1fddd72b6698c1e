"""The tasks of grid worlds: reach the goal square, or follow an instruction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import expert as experts
from envs_jax.minigrid import instructions, planner, tiles
from envs_jax.minigrid.environment import FORWARD, at_index, front_index
from envs_jax.minigrid.errands import errand_expert
from envs_jax.minigrid.instructions import Program, Progress
from envs_jax.minigrid.state import GridState
from envs_jax.minigrid.subgoals import Subgoal, inner, instruction_subgoal
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
    """Progress of an `InstructionTask`; see `instructions` for what the words mean.

    Attributes:
      steps: int32 scalar, steps taken so far.
      max_steps: int32 scalar, the horizon that rewards are measured by.
      mission: int32[length] tokens.
      program: uint32 scalar, a packed `instructions.Program`; None in a `GoToTask`.
      progress: uint8 scalar, a packed `instructions.Progress`; None likewise.
      ghosts: uint32[beliefs, height], bit x of row y: clause i errs about cell (x, y). In play such
        a cell is one that a place of the clause has left: it is still believed there.
    """

    steps: jax.Array
    max_steps: jax.Array
    mission: jax.Array
    program: jax.Array | None
    progress: jax.Array | None
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

    def subgoal(self, task_state: GoalState, state: GridState) -> Subgoal:
        """Returns what there is to do: to step onto a goal square."""
        del task_state
        goals = planner.pack(inner(state.tiles) & tiles.TYPE_MASK == tiles.GOAL)
        return Subgoal.of(goals, FORWARD)


@dataclass(frozen=True)
class InstructionTask(Task):
    """Follow a BabyAI instruction of up to four clauses: go to, open, pick up, put next to.

    The reward of success is `GoalTask`'s. Failure, which strict clauses know, earns nothing.
    `beliefs` is how many of the first clauses can be of the kind "go to".

    Source: `RoomGridLevel.step` and `verifier` of minigrid 3.2.0.
    """

    width: int
    height: int
    beliefs: int = instructions.MAX_CLAUSES
    slope: float = REWARD_SLOPE

    def step(
        self, task_state: InstructionState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[InstructionState, Outcome]:
        """Judges one step; see `Task.step`."""
        ghosts = instructions.believe(task_state.ghosts, before, action, after)
        program, progress = self._read(task_state)
        progress, done, failed = instructions.verify(
            program, progress, ghosts, before, action, after
        )
        steps = task_state.steps + 1
        task_state = replace(task_state, steps=steps, ghosts=ghosts)
        task_state = self._write(task_state, progress)
        # No level has a goal square or lava, but worlds are free to.
        goal, lava = entered(before, action, after, self.height)
        reward = success_reward(self.slope, steps, task_state.max_steps)
        return task_state, Outcome(
            reward={"success": jnp.where(done | (goal & ~failed), reward, jnp.float32(0))},
            success={"instruction": done},
            terminated=done | failed | goal | lava,
            metrics={},
        )

    def expert(
        self, key: jax.Array, task_state: InstructionState, state: GridState
    ) -> ExpertAction:
        """Returns the next action towards the first clause not done; see `errand_expert`."""
        return errand_expert(key, self.subgoal(task_state, state), state, self.height)

    def subgoal(self, task_state: InstructionState, state: GridState) -> Subgoal:
        """Returns what the first clause that counts and is not done wants next."""
        return instruction_subgoal(*self._read(task_state), task_state.ghosts, state)

    def _read(self, task_state: InstructionState) -> tuple[Program, Progress]:
        assert task_state.program is not None
        assert task_state.progress is not None
        return Program.unpack(task_state.program), Progress.unpack(task_state.progress)

    def _write(self, task_state: InstructionState, progress: Progress) -> InstructionState:
        return replace(task_state, progress=progress.pack())


@dataclass(frozen=True)
class GoToTask(InstructionTask):
    """Follow an instruction whose one clause is to go to an object.

    Its expert knows the shortest way where keys are needed, too. Its states hold no program and no
    progress: what is the same in all of them is compiled in.
    """

    beliefs: int = 1

    def _read(self, task_state: InstructionState) -> tuple[Program, Progress]:
        return Program.unpack(jnp.uint32(instructions.ONE_GO_TO)), Progress.unpack(jnp.uint8(0))

    def _write(self, task_state: InstructionState, progress: Progress) -> InstructionState:
        return task_state

    def expert(
        self, key: jax.Array, task_state: InstructionState, state: GridState
    ) -> ExpertAction:
        """Returns the first action of a shortest plan to face an object of the instruction."""
        return experts.goto_expert(key, task_state, state, self.width, self.height)
