"""Import of live Python MiniGrid environments, at any moment of an episode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax import registry
from envs_jax.minigrid import tiles
from envs_jax.minigrid.catalogue import compose
from envs_jax.minigrid.following import Following
from envs_jax.minigrid.late_hands import NOWHERE, LateHandsState, LateHandsWorld
from envs_jax.minigrid.missions import COLOR_WORDS, MISSION_LENGTH, encode_mission, word_tokens
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, GridState
from envs_jax.minigrid.tasks import (
    GoalState,
    GoalTask,
    GoToTask,
    InstructionState,
    InstructionTask,
)
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, PyTree, State, Task, TaskSampler

_KINDS = {
    "wall": tiles.WALL,
    "floor": tiles.FLOOR,
    "key": tiles.KEY,
    "ball": tiles.BALL,
    "box": tiles.BOX,
    "goal": tiles.GOAL,
    "lava": tiles.LAVA,
}


@dataclass(frozen=True)
class FixedSampler(TaskSampler):
    """Always yields the same episode, kept as hashable bytes; see `FixedSampler.of`.

    Attributes:
      leaves: (dtype, shape, bytes) of every array of the episode.
      structure: the episode's tree.
    """

    leaves: tuple[tuple[str, tuple[int, ...], bytes], ...]
    structure: Any

    @classmethod
    def of(cls, episode: Episode) -> FixedSampler:
        """Returns the sampler of `episode`, whose arrays must be concrete."""
        leaves, structure = jax.tree.flatten(episode)
        arrays = [np.asarray(leaf) for leaf in leaves]
        packed = tuple((str(array.dtype), array.shape, array.tobytes()) for array in arrays)
        return cls(packed, structure)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Returns the episode; `key` is not used."""
        del key, sampler_state
        arrays = [
            jnp.asarray(np.frombuffer(data, dtype).reshape(shape))
            for dtype, shape, data in self.leaves
        ]
        return jax.tree.unflatten(self.structure, arrays)


def from_minigrid(env: Any) -> tuple[POMDP, State]:
    """Imports a Python environment as it stands, to be stepped on with `pomdp.step`.

    Any moment of an episode will do, and any change made by hand to the grid, to doors, boxes and
    hands, to the agent's pose, to `step_count` or `max_steps`. The Python environment is only read.

    Args:
      env: an unwrapped `minigrid.minigrid_env.MiniGridEnv` that was reset at least once.

    Returns:
      The POMDP, whose sampler yields this very episode (what is left of it), and its state. Goal
      worlds come out with a `GoalTask`, BabyAI's levels with an `InstructionTask`. An environment
      with an id of `envs_jax.ids()` comes out with that world's own task and sensors, so that all
      its episodes have one structure.

    Raises:
      JaxactError: `env` is no such environment, or follows rules that are not supported, or holds
        what no tile can show. The message names it.
    """
    from minigrid.minigrid_env import MiniGridEnv

    if not isinstance(env, MiniGridEnv):
        raise JaxactError(f"from_minigrid takes an unwrapped MiniGridEnv; got {type(env).__name__}")
    if env.agent_pos is None:
        raise JaxactError(f"{_name(env)} was never reset; call env.reset() before from_minigrid")
    following = _following(env)
    pomdp = _frame(env, following)
    world: GridState = _import_grid(env, following)
    if isinstance(pomdp.environment, LateHandsWorld):
        world = LateHandsState.of(world, jnp.array(NOWHERE, jnp.int32))
    task_state = _import_progress(env, following, pomdp)
    episode = Episode(world, task_state, jnp.int32(env.max_steps - env.step_count))
    pomdp = replace(pomdp, sampler=FixedSampler.of(episode))
    return pomdp, State(world, task_state, jnp.int32(env.step_count), jnp.int32(env.max_steps))


def _name(env: Any) -> str:
    return env.spec.id if env.spec is not None else type(env).__name__


def _following(env: Any) -> Following | None:
    """Returns the instruction that is followed, or None in a goal world."""
    from minigrid.envs.babyai.core.roomgrid_level import RoomGridLevel
    from minigrid.minigrid_env import MiniGridEnv

    rule = type(env).step
    if rule is MiniGridEnv.step:
        return None
    if rule is RoomGridLevel.step:
        return Following.of(env, _name(env))
    raise JaxactError(
        f"{_name(env)} ends by rules that from_minigrid does not know; supported are worlds "
        "that end at a goal square (those that keep MiniGridEnv.step) and BabyAI levels (those "
        "that keep RoomGridLevel.step)"
    )


def _frame(env: Any, following: Following | None) -> POMDP:
    """Returns the POMDP of `env`, but for its sampler."""
    size = (int(env.width), int(env.height))
    words = len(word_tokens(env.mission))
    task: Task
    if following is None:
        task, length = GoalTask(*size), MISSION_LENGTH
    else:
        task = GoToTask(*size) if following.is_go_to else InstructionTask(*size)
        length = words
    made = registry.make(_name(env)) if _name(env) in registry.ids() else None
    if made is not None and _suits(made.task, size, following):
        (room,) = made.observation_space.spaces["mission"].structure.shape
        task, length = made.task, max(room, words)
    late_hands = made is not None and isinstance(made.environment, LateHandsWorld)
    return compose(
        task,
        FixedSampler((), None),
        *size,
        see_through_walls=bool(env.see_through_walls),
        view_size=int(env.agent_view_size),
        mission_length=length,
        environment=LateHandsWorld(*size) if late_hands else None,
    )


def _suits(task: Task, size: tuple[int, int], following: Following | None) -> bool:
    """Whether a registered world's task can go on with what `env` is about."""
    if following is None:
        return isinstance(task, GoalTask) and (task.width, task.height) == size
    return (
        isinstance(task, InstructionTask)
        and (task.width, task.height) == size
        and (task.beliefs >= following.beliefs)
        and (following.is_go_to or not isinstance(task, GoToTask))
    )


def _import_progress(env: Any, following: Following | None, pomdp: POMDP) -> PyTree:
    steps, max_steps = jnp.int32(env.step_count), jnp.int32(env.max_steps)
    (length,) = pomdp.observation_space.spaces["mission"].structure.shape
    mission = jnp.asarray(encode_mission(env.mission, length))
    if following is None:
        return GoalState(steps, max_steps, mission)
    assert isinstance(pomdp.task, InstructionTask)
    is_general = not isinstance(pomdp.task, GoToTask)
    return InstructionState(
        steps,
        max_steps,
        mission,
        program=following.program().pack() if is_general else None,
        progress=following.progress().pack() if is_general else None,
        ghosts=jnp.asarray(following.ghosts(pomdp.task.beliefs)),
    )


def _import_grid(env: Any, following: Following | None) -> GridState:
    plane = np.full((env.width, env.height), tiles.EMPTY_TILE, np.uint8)
    marks = np.zeros((env.width, env.height), np.uint16)
    for x in range(env.width):
        for y in range(env.height):
            thing = env.grid.get(x, y)
            if thing is not None:
                plane[x, y], marks[x, y] = _tile(env, thing), _mark(env, thing, following)
    held = env.carrying
    return GridState(
        tiles=jnp.asarray(np.pad(plane, PADDING, constant_values=tiles.WALL_TILE).reshape(-1)),
        marks=jnp.asarray(np.pad(marks, PADDING).reshape(-1)),
        position=jnp.asarray(np.asarray(env.agent_pos, np.int32)),
        direction=jnp.int32(env.agent_dir),
        carrying=jnp.uint8(0 if held is None else _tile(env, held)),
        carrying_mark=jnp.uint16(0 if held is None else _mark(env, held, following)),
    )


def _tile(env: Any, thing: Any) -> int:
    """Returns the packed tile of a MiniGrid object."""
    if thing.type == "door":
        if thing.is_open:
            kind = tiles.OPEN_LOCKED_DOOR if thing.is_locked else tiles.OPEN_DOOR
        else:
            kind = tiles.LOCKED_DOOR if thing.is_locked else tiles.CLOSED_DOOR
    elif thing.type in _KINDS:
        kind = _KINDS[thing.type]
    else:
        raise JaxactError(f"{_name(env)} holds a {thing.type!r}, which no tile can show")
    return tiles.tile(kind, COLOR_WORDS.index(thing.color))


def _mark(env: Any, thing: Any, following: Following | None) -> int:
    """Returns the mark of a MiniGrid object: which clauses are about it, and what it contains."""
    mark = 0 if following is None else following.mark(thing)
    content = getattr(thing, "contains", None)
    if thing.type != "box" or content is None:
        return mark
    if content.type != "key" or (following is not None and following.mark(content)):
        raise JaxactError(
            f"{_name(env)} has a box with a {content.type} in it; boxes may contain keys (but not "
            "one that the instruction is about)"
        )
    return mark | (COLOR_WORDS.index(content.color) + 1) << CONTENTS_SHIFT
