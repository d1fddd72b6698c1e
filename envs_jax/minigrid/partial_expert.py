"""Experts that know what the agent has seen, and explore what it has not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import jax
import jax.numpy as jnp

from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import DONE, TOGGLE
from envs_jax.minigrid.errands import first_errand_expert
from envs_jax.minigrid.planner import Board
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.samplers.changed import ChangedEpisodes
from envs_jax.minigrid.sensors import GridSensor, PackedImageSensor
from envs_jax.minigrid.state import PADDING, TRACKED_MASK, GridState
from envs_jax.minigrid.subgoals import Subgoal, inner
from envs_jax.minigrid.tasks import GoalTask, GoToTask, InstructionTask
from envs_jax.minigrid.views import FullImageSensor, RGBFullImageSensor
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, ExpertAction, Outcome, PyTree, Task

# Those in whose worlds nothing changes out of the agent's sight.
_TASKS = (GoalTask, GoToTask, InstructionTask, RuleTask)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PartialState:
    """Progress of a `PartialTask`.

    Attributes:
      task: the state of the task itself.
      seen: word[H], bit x of row y: the agent has had cell (x, y) in sight; see `planner`.
    """

    task: PyTree
    seen: Board

    @property
    def mission(self) -> jax.Array:
        """The task's mission, int32[length] tokens."""
        return self.task.mission


@dataclass(frozen=True)
class PartialTask(Task):
    """A task whose expert knows no more of the world than what the agent has seen of it.

    Known are the cells that have been in the agent's view since the episode began, as they are:
    out of its sight nothing changes. What the task is about is recognised when it is seen. A
    closed box does not show what it contains.

    The advice is, first, the next action towards what the task wants, as of `errand_expert`, if in
    the known part of the world there is a way to it. Otherwise it is that towards the nearest place
    where the agent faces an unseen cell, through closed doors as well, and through locked ones and
    past objects where nothing nearer is left. With nothing left to explore, boxes of which the task
    does not speak are opened, for there may be a key in them. When there are none, the advice is to
    put down what is held; after that it is not valid.

    Attributes:
      task: the task.
      view: what the agent sees.
    """

    task: GoalTask | InstructionTask | RuleTask
    view: PackedImageSensor

    def step(
        self, task_state: PartialState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[PartialState, Outcome]:
        """Judges one step, as the task does; see `Task.step`."""
        inner_state, outcome = self.task.step(task_state.task, before, action, after)
        seen = task_state.seen | planner.pack(self.view.visible(after))
        return PartialState(inner_state, seen), outcome

    def expert(self, key: jax.Array, task_state: PartialState, state: GridState) -> ExpertAction:
        """Returns the next action of an agent that knows what this one has seen."""
        known = _known(state, task_state.seen)
        kinds = inner(known.tiles) & tiles.TYPE_MASK
        is_own = inner(known.marks) & TRACKED_MASK != 0
        wanted = self.task.subgoal(task_state.task, known)
        unseen = _instead(wanted, planner.pack(kinds == tiles.UNSEEN), DONE)
        boxes = _instead(wanted, planner.pack((kinds == tiles.BOX) & ~is_own), TOGGLE)
        return first_errand_expert(key, [wanted, unseen, boxes], known, self.view.height)


@dataclass(frozen=True)
class PartialSampler(ChangedEpisodes):
    """The episodes of a sampler, for a `PartialTask`.

    Attributes:
      view: what the agent sees.
    """

    view: PackedImageSensor

    def change(self, episode: Episode) -> Episode:
        """Returns the episode with what is in sight as it begins."""
        seen = planner.pack(self.view.visible(episode.environment))
        return replace(episode, task=PartialState(episode.task, seen))


def partially_observing(pomdp: POMDP) -> POMDP:
    """Returns a grid world whose expert knows what the agent has seen; see `PartialTask`.

    Args:
      pomdp: the world. Its sensor "image" shows the agent's view: that is what counts as seen.

    Raises:
      JaxactError: the world's task is none whose expert can do without the rest of the world, its
        sensor "image" does not show a part of it, or its sampler learns.
    """
    sensor = pomdp.sensors.get("image")
    if type(pomdp.task) not in _TASKS:
        name = type(pomdp.task).__name__
        raise JaxactError(f"the expert of {name} cannot be told to know no more than the agent")
    if not isinstance(sensor, GridSensor) or isinstance(
        sensor, FullImageSensor | RGBFullImageSensor
    ):
        raise JaxactError(
            "a partially observing expert needs a sensor 'image' of the agent's own view, such as "
            "that of the observations image, packed and rgb"
        )
    task = PartialTask(cast(GoalTask | InstructionTask | RuleTask, pomdp.task), sensor.view)
    return replace(pomdp, task=task, sampler=PartialSampler(pomdp.sampler, sensor.view))


def _known(state: GridState, seen: Board) -> GridState:
    """Returns the world with all cells `UNSEEN` that are not on the board, and all boxes empty."""
    width = state.tiles.shape[0] - 2 * PADDING
    columns = jnp.arange(width, dtype=seen.dtype)[:, None]
    is_seen = jnp.pad(seen >> columns & 1 != 0, PADDING, constant_values=True)
    cells = jnp.where(is_seen, state.tiles, jnp.uint8(tiles.UNSEEN))
    marks = jnp.where(is_seen, state.marks, jnp.uint16(0)) & jnp.uint16(TRACKED_MASK)
    return replace(
        state,
        tiles=cells,
        marks=marks,
        carrying_mark=state.carrying_mark & jnp.uint16(TRACKED_MASK),
    )


def _instead(subgoal: Subgoal, cells: Board, action: int) -> Subgoal:
    """Returns another subgoal, under the restrictions of this one."""
    return replace(
        subgoal,
        cells=cells,
        action=jnp.int32(action),
        stands=jnp.bool_(False),
        must_drop=jnp.bool_(False),
        destination=jnp.zeros_like(cells),
    )
