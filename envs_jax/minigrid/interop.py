"""Import of live Python MiniGrid environments, at any moment of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax import registry
from envs_jax.minigrid import tiles
from envs_jax.minigrid.catalogue import compose
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.instruction_import import ImportedInstruction
from envs_jax.minigrid.late_hands import NOWHERE, LateHandsState, LateHandsWorld
from envs_jax.minigrid.missions import COLOR_WORDS, MISSION_LENGTH, encode_mission, word_tokens
from envs_jax.minigrid.obstacles import ObstacleState, ObstacleTask, ObstacleWorld
from envs_jax.minigrid.rule_import import ImportedRule, import_rule
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.sensors import MissionSensor
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, GridState
from envs_jax.minigrid.tasks import GoalState, GoalTask
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Environment, Episode, PyTree, State, Task, TaskSampler

_KINDS = {
    "wall": tiles.WALL,
    "floor": tiles.FLOOR,
    "key": tiles.KEY,
    "ball": tiles.BALL,
    "box": tiles.BOX,
    "goal": tiles.GOAL,
    "lava": tiles.LAVA,
}
# What an environment is about; None where there is but a goal square to reach.
_About = ImportedRule | ImportedInstruction | None


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
      worlds come out with a `GoalTask`, BabyAI's levels with an `InstructionTask`,
      Dynamic-Obstacles with an `ObstacleTask`, MiniGrid's other worlds with a `RuleTask`. An
      environment with an id of `envs_jax.ids()` comes out with that world's own task and sensors,
      so that all its episodes have one structure.

    Raises:
      JaxactError: `env` is no such environment, or follows rules that are not supported, or holds
        what no tile can show. The message names it.
    """
    from minigrid.minigrid_env import MiniGridEnv

    if not isinstance(env, MiniGridEnv):
        raise JaxactError(f"from_minigrid takes an unwrapped MiniGridEnv; got {type(env).__name__}")
    if env.agent_pos is None:
        raise JaxactError(f"{_name(env)} was never reset; call env.reset() before from_minigrid")
    about = _import_about(env)
    own = registry.make(_name(env)) if _name(env) in registry.ids() else None
    length = _mission_length(env, own)
    mission = jnp.asarray(encode_mission(env.mission, length))
    task, task_state = _import_task(env, about, mission, own)
    environment, world = _import_environment(env, _import_grid(env, about))
    pomdp = compose(
        task,
        FixedSampler.of(Episode(world, task_state, jnp.int32(env.max_steps - env.step_count))),
        env.width,
        env.height,
        environment=environment,
        see_through_walls=bool(env.see_through_walls),
        view_size=int(env.agent_view_size),
        mission_length=length,
    )
    state = State(world, task_state, jnp.int32(env.step_count), jnp.int32(env.max_steps))
    return pomdp, state


def _name(env: Any) -> str:
    return env.spec.id if env.spec is not None else type(env).__name__


def _import_about(env: Any) -> _About:
    """Returns what `env` is about."""
    from minigrid.envs.babyai.core.roomgrid_level import RoomGridLevel
    from minigrid.minigrid_env import MiniGridEnv

    rule = import_rule(env)
    if rule is not None or type(env).step is MiniGridEnv.step or _has_obstacles(env):
        return rule
    if type(env).step is RoomGridLevel.step:
        return ImportedInstruction.of(env, _name(env))
    raise JaxactError(
        f"{_name(env)} ends by rules that from_minigrid does not know; supported are the worlds "
        "registered as MiniGrid-… and BabyAI-…, and others that keep MiniGridEnv.step or "
        "RoomGridLevel.step"
    )


def _mission_length(env: Any, own: POMDP | None) -> int:
    """Returns how many words the longest mission has in worlds such as `env`."""
    sensor = own.sensors.get("mission") if own is not None else None
    length = sensor.length if isinstance(sensor, MissionSensor) else MISSION_LENGTH
    return max(length, len(word_tokens(env.mission)))


def _import_task(
    env: Any, about: _About, mission: jax.Array, own: POMDP | None
) -> tuple[Task, PyTree]:
    """Returns the task and its state."""
    size = (int(env.width), int(env.height))
    if isinstance(about, ImportedRule):
        return RuleTask(*size), about.state(env, mission)
    if isinstance(about, ImportedInstruction):
        task = about.task(size, None if own is None else own.task)
        return task, about.state(task, mission)
    state = GoalState(jnp.int32(env.step_count), jnp.int32(env.max_steps), mission)
    return ObstacleTask(*size) if _has_obstacles(env) else GoalTask(*size), state


def _import_environment(env: Any, world: GridState) -> tuple[Environment, GridState]:
    """Returns the environment, and its state, of which `world` is what all of them have."""
    from minigrid.envs import MemoryEnv
    from minigrid.envs.babyai import PutNext

    size = (int(env.width), int(env.height))
    if _has_obstacles(env):
        obstacles = [ball.cur_pos for ball in env.obstacles]
        return ObstacleWorld(*size), ObstacleState.of(world, jnp.asarray(obstacles, jnp.int32))
    if isinstance(env, PutNext) and env.start_carrying:
        return LateHandsWorld(*size), LateHandsState.of(world, jnp.array(NOWHERE, jnp.int32))
    return GridWorld(*size, pickup_toggles=type(env).step is MemoryEnv.step), world


def _has_obstacles(env: Any) -> bool:
    from minigrid.envs import DynamicObstaclesEnv

    return type(env).step is DynamicObstaclesEnv.step


def _import_grid(env: Any, about: _About) -> GridState:
    plane = np.full((env.width, env.height), tiles.EMPTY_TILE, np.uint8)
    marks = np.zeros((env.width, env.height), np.uint16)
    for x, y in np.ndindex(plane.shape):
        thing = env.grid.get(x, y)
        if thing is not None:
            plane[x, y], marks[x, y] = _tile(env, thing), _mark(env, thing, about)
    held = env.carrying
    return GridState(
        tiles=jnp.asarray(np.pad(plane, PADDING, constant_values=tiles.WALL_TILE)),
        marks=jnp.asarray(np.pad(marks, PADDING)),
        position=jnp.asarray(np.asarray(env.agent_pos, np.int32)),
        direction=jnp.int32(env.agent_dir),
        carrying=jnp.uint8(0 if held is None else _tile(env, held)),
        carrying_mark=jnp.uint16(0 if held is None else _mark(env, held, about)),
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


def _mark(env: Any, thing: Any, about: _About) -> int:
    """Returns the mark of a MiniGrid object: what it is tracked for, and what it contains."""
    mark = 0 if about is None else about.mark(thing)
    content = getattr(thing, "contains", None)
    if thing.type != "box" or content is None:
        return mark
    if content.type != "key" or (about is not None and about.mark(content)):
        raise JaxactError(
            f"{_name(env)} has a box with a {content.type} in it; boxes may contain keys (but not "
            "one that the instruction is about)"
        )
    return mark | (COLOR_WORDS.index(content.color) + 1) << CONTENTS_SHIFT
