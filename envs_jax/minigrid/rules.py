"""The tasks of MiniGrid's other worlds: to fetch, to open, to put down, to match.

Which of them an episode is about is part of its data, so worlds of one shape can share a batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import (
    DONE,
    DROP,
    FORWARD,
    OPEN_DOORS,
    PICKUP,
    PORTABLE,
    TOGGLE,
    at_index,
    cell_index,
    heading,
    is_kind,
)
from envs_jax.minigrid.errands import errand_expert
from envs_jax.minigrid.planner import Board
from envs_jax.minigrid.regions import around, beside, cell_board
from envs_jax.minigrid.state import TRACKED_MASK, GridState
from envs_jax.minigrid.subgoals import Subgoal, inner
from envs_jax.minigrid.tasks import REWARD_SLOPE, entered, success_reward
from jaxact.pomdp import ExpertAction, Outcome, Task

# What an episode is about; `RuleTask` says when it ends.
PLAY, PICK_UP, OPEN, FETCH, GO_NEXT_TO, PUT_NEAR, MATCH, OPEN_IN_TURN = range(8)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RuleState:
    """Progress of a `RuleTask`. What a rule has no use for is 0.

    Attributes:
      steps: int32 scalar, steps taken so far.
      max_steps: int32 scalar, the horizon that rewards are measured by.
      mission: int32[MISSION_LENGTH] tokens.
      rule: int32 scalar, one of `PLAY` … `OPEN_IN_TURN`.
      target: uint8 scalar, the packed tile of what to fetch or to put down.
      cells: int32[2, 2], cells (x, y) that the rule is about.
      opened: bool[2], whether open doors stand in `cells`.
    """

    steps: jax.Array
    max_steps: jax.Array
    mission: jax.Array
    rule: jax.Array
    target: jax.Array
    cells: jax.Array
    opened: jax.Array


@dataclass(frozen=True)
class RuleTask(Task):
    """Do what the episode's rule asks for.

    - `PLAY`: nothing.
    - `PICK_UP`: pick up the object that is tracked.
    - `OPEN`: toggle, so that the door in the first cell stands open.
    - `FETCH`: have an object in hand that looks like the target; any other object ends it.
    - `GO_NEXT_TO`: take the action done next to the first cell; elsewhere, or with the action
      toggle, it ends in vain.
    - `PUT_NEAR`: drop the target at most one cell (diagonals included) from the first cell.
      Dropping it elsewhere ends it, even in vain, and so does picking up anything else.
    - `MATCH`: step onto the first cell, not onto the second.
    - `OPEN_IN_TURN`: open the door in the second cell while that in the first stands open already.
      It ends as well when the second is opened without that, or the first after the second.

    Whatever the rule, a goal square is success too, and lava ends the episode. The reward of
    success is `GoalTask`'s. Source: the `step` methods in `minigrid.envs` of minigrid 3.2.0.
    """

    width: int
    height: int
    slope: float = REWARD_SLOPE

    def step(
        self, task_state: RuleState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[RuleState, Outcome]:
        """Judges one step; see `Task.step`."""
        opened = self._opened(task_state.cells, after)
        over, won = _judge(task_state, before.carrying != 0, action, after, opened)
        goal, lava = entered(before, action, after, self.height)
        won = jnp.where(over, won, goal)
        task_state = replace(task_state, steps=task_state.steps + 1, opened=opened)
        reward = success_reward(self.slope, task_state.steps, task_state.max_steps)
        return task_state, Outcome(
            reward={"success": jnp.where(won, reward, jnp.float32(0))},
            success={"goal": won},
            terminated=over | goal | lava,
            metrics={},
        )

    def expert(self, key: jax.Array, task_state: RuleState, state: GridState) -> ExpertAction:
        """Returns the next action towards what the rule asks for; see `errand_expert`.

        With the rule `PLAY` the advice is never valid.
        """
        return errand_expert(key, self.subgoal(task_state, state), state, self.height)

    def subgoal(self, task_state: RuleState, state: GridState) -> Subgoal:
        """Returns what the rule wants next.

        Cells of type `UNSEEN` are not known to be what the rule is about. Which of two is the match
        is not known before three objects can be seen: both choices, and what one is to match.
        """
        cells, marks = inner(state.tiles), inner(state.marks)
        empty = planner.pack(cells == tiles.EMPTY_TILE)
        targets = planner.pack(cells == task_state.target)
        seen = planner.pack(cells != tiles.UNSEEN)
        first, second = (cell_board(cell, empty) & seen for cell in task_state.cells)
        holds = state.carrying == task_state.target
        no, yes = jnp.bool_(False), jnp.bool_(True)
        nothing = jnp.zeros_like(empty)
        is_told = jnp.sum(is_kind(cells, PORTABLE), dtype=jnp.int32) >= 3
        match = jnp.where(is_told, first, nothing)
        # For each rule: the cells, what to do there, whether objects may be moved, doors opened.
        wishes: dict[int, tuple[Board, jax.Array | int, jax.Array, jax.Array]] = {
            PICK_UP: (planner.pack(marks & TRACKED_MASK != 0), PICKUP, yes, yes),
            OPEN: (first, TOGGLE, yes, yes),
            FETCH: (targets, PICKUP, no, yes),
            GO_NEXT_TO: (beside(first) & empty, DONE, yes, no),
            PUT_NEAR: (
                jnp.where(holds, around(first) & empty, targets),
                jnp.where(holds, DROP, PICKUP),
                no,
                yes,
            ),
            MATCH: (match, FORWARD, no, yes),
            OPEN_IN_TURN: (jnp.where(task_state.opened[0], second, first), TOGGLE, yes, yes),
        }
        wanted, action, may_move, may_open = nothing, jnp.int32(DONE), no, no
        for rule, (where, what, moves, opens) in wishes.items():
            applies = task_state.rule == rule
            wanted, action = jnp.where(applies, where, wanted), jnp.where(applies, what, action)
            may_move, may_open = may_move | applies & moves, may_open | applies & opens
        return Subgoal.of(
            wanted,
            action,
            stands=task_state.rule == GO_NEXT_TO,
            forbidden=jnp.where(task_state.rule == MATCH, (first | second) & ~match, nothing),
            may_move=may_move,
            may_open=may_open,
        )

    def _opened(self, cells: jax.Array, state: GridState) -> jax.Array:
        """Returns bool[2], whether open doors stand in `cells`."""
        found = [at_index(state.tiles, cell_index(cell, self.height)) for cell in cells]
        return is_kind(jnp.stack(found), OPEN_DOORS)


def _judge(
    task_state: RuleState,
    hands_were_full: jax.Array,
    action: jax.Array,
    after: GridState,
    opened: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Returns two bools: whether the rule ends the episode, and whether with success."""
    first, second = task_state.cells
    here = after.position
    empty_handed, holds = after.carrying == 0, after.carrying == task_state.target
    tracked = after.carrying_mark & TRACKED_MASK != 0
    in_front = here + heading(after.direction)
    drops = (action == DROP) & hands_were_full
    drops_near = drops & empty_handed & (jnp.max(jnp.abs(in_front - first)) <= 1)
    is_beside = jnp.sum(jnp.abs(here - first), dtype=jnp.int32) == 1
    is_first, is_second = jnp.all(here == first), jnp.all(here == second)
    had_opened = task_state.opened

    picks = (action == PICKUP) & tracked
    opens = (action == TOGGLE) & opened[0]
    verdicts = {
        PICK_UP: (picks, picks),
        OPEN: (opens, opens),
        FETCH: (~empty_handed, holds),
        GO_NEXT_TO: ((action == TOGGLE) | (action == DONE), (action == DONE) & is_beside),
        PUT_NEAR: (drops | (action == PICKUP) & ~empty_handed & ~holds, drops_near),
        MATCH: (is_first | is_second, is_first),
        OPEN_IN_TURN: (opened[1] | opened[0] & had_opened[1], opened[1] & had_opened[0]),
    }
    over = won = jnp.bool_(False)
    for rule, (ends, succeeds) in verdicts.items():
        applies = task_state.rule == rule
        over, won = over | applies & ends, won | applies & succeeds
    return over, won
