"""Import of live Python MiniGrid environments, at any moment of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.catalogue import compose
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.missions import COLOR_WORDS, encode_mission
from envs_jax.minigrid.obstacles import ObstacleState, ObstacleTask, ObstacleWorld
from envs_jax.minigrid.rule_import import import_rule
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, GridState
from envs_jax.minigrid.tasks import GoalState, GoalTask, InstructionState, InstructionTask
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
      worlds come out with a `GoalTask`, BabyAI's GoTo levels with an `InstructionTask`,
      Dynamic-Obstacles with an `ObstacleTask`, MiniGrid's other worlds with a `RuleTask`.

    Raises:
      JaxactError: `env` is no such environment, or follows rules that are not supported, or holds
        what no tile can show. The message names it.
    """
    from minigrid.minigrid_env import MiniGridEnv

    if not isinstance(env, MiniGridEnv):
        raise JaxactError(f"from_minigrid takes an unwrapped MiniGridEnv; got {type(env).__name__}")
    if env.agent_pos is None:
        raise JaxactError(f"{_name(env)} was never reset; call env.reset() before from_minigrid")
    task, task_state, description = _import_task(env)
    environment, world = _import_environment(env, _import_grid(env, description))
    pomdp = compose(
        task,
        FixedSampler.of(Episode(world, task_state, jnp.int32(env.max_steps - env.step_count))),
        env.width,
        env.height,
        environment=environment,
        see_through_walls=bool(env.see_through_walls),
        view_size=int(env.agent_view_size),
    )
    state = State(world, task_state, jnp.int32(env.step_count), jnp.int32(env.max_steps))
    return pomdp, state


def _name(env: Any) -> str:
    return env.spec.id if env.spec is not None else type(env).__name__


def _import_environment(env: Any, world: GridState) -> tuple[Environment, GridState]:
    """Returns the environment, and its state, of which `world` is what all of them have."""
    from minigrid.envs import DynamicObstaclesEnv, MemoryEnv

    size = (int(env.width), int(env.height))
    if type(env).step is DynamicObstaclesEnv.step:
        obstacles = [ball.cur_pos for ball in env.obstacles]
        return ObstacleWorld(*size), ObstacleState.of(world, jnp.asarray(obstacles, jnp.int32))
    return GridWorld(*size, pickup_toggles=type(env).step is MemoryEnv.step), world


def _import_task(env: Any) -> tuple[Task, PyTree, Any]:
    """Returns the task, its state, and the description of the objects to go to (or None)."""
    from minigrid.envs import DynamicObstaclesEnv
    from minigrid.envs.babyai.core.roomgrid_level import RoomGridLevel
    from minigrid.envs.babyai.core.verifier import GoToInstr, ObjDesc
    from minigrid.minigrid_env import MiniGridEnv

    size = (int(env.width), int(env.height))
    steps, max_steps = jnp.int32(env.step_count), jnp.int32(env.max_steps)
    known = import_rule(env)
    if known is not None:
        # Described as an instruction does that means this very object, whatever it looks like.
        description = ObjDesc(None)
        description.obj_set = [] if known.tracked is None else [known.tracked]
        return RuleTask(*size), known.state(env), description
    rule = type(env).step
    if rule in (MiniGridEnv.step, DynamicObstaclesEnv.step):
        task = GoalTask(*size) if rule is MiniGridEnv.step else ObstacleTask(*size)
        mission = jnp.asarray(encode_mission(env.mission))
        return task, GoalState(steps, max_steps, mission), None
    if rule is RoomGridLevel.step and type(env.instrs) is GoToInstr:
        mission = jnp.asarray(encode_mission(env.mission))
        ghosts = jnp.asarray(_ghosts(env, env.instrs.desc))
        state = InstructionState(steps, max_steps, mission, ghosts)
        return InstructionTask(*size), state, env.instrs.desc
    raise JaxactError(
        f"{_name(env)} ends by rules that from_minigrid does not know; supported are the worlds "
        "registered as MiniGrid-…, others that keep MiniGridEnv.step, and BabyAI levels whose "
        "instruction is one GoTo"
    )


def _cells(env: Any) -> list[tuple[int, int, Any]]:
    """Returns (x, y, object) of all cells that are not empty."""
    cells = [(x, y, env.grid.get(x, y)) for x in range(env.width) for y in range(env.height)]
    return [cell for cell in cells if cell[2] is not None]


def _fits(thing: Any, description: Any) -> bool:
    """Whether `description` will find `thing` again when it next looks (it follows identities)."""
    return (
        description is not None
        and any(thing is other for other in description.obj_set)
        and description.type in (None, thing.type)
        and description.color in (None, thing.color)
    )


def _ghosts(env: Any, description: Any) -> np.ndarray:
    """Returns uint32[1, height]: where `description` errs about where its objects are."""
    believed = {(int(x), int(y)) for x, y in description.obj_poss}
    actual = {(x, y) for x, y, thing in _cells(env) if _fits(thing, description)}
    rows = np.zeros((1, env.height), np.uint32)
    for x, y in believed ^ actual:
        rows[0, y] |= np.uint32(1 << x)
    return rows


def _import_grid(env: Any, description: Any) -> GridState:
    plane = np.full((env.width, env.height), tiles.EMPTY_TILE, np.uint8)
    marks = np.zeros((env.width, env.height), np.uint16)
    for x, y, thing in _cells(env):
        plane[x, y] = _tile(env, thing)
        marks[x, y] = _mark(env, thing, description)
    held = env.carrying
    return GridState(
        tiles=jnp.asarray(np.pad(plane, PADDING, constant_values=tiles.WALL_TILE)),
        marks=jnp.asarray(np.pad(marks, PADDING)),
        position=jnp.asarray(np.asarray(env.agent_pos, np.int32)),
        direction=jnp.int32(env.agent_dir),
        carrying=jnp.uint8(0 if held is None else _tile(env, held)),
        carrying_mark=jnp.uint16(0 if held is None else _mark(env, held, description)),
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


def _mark(env: Any, thing: Any, description: Any) -> int:
    """Returns the mark of a MiniGrid object: whether it is tracked, and what it contains."""
    mark = int(_fits(thing, description))
    content = getattr(thing, "contains", None)
    if thing.type != "box" or content is None:
        return mark
    if content.type != "key" or _fits(content, description):
        raise JaxactError(
            f"{_name(env)} has a box with a {content.type} in it; boxes may contain keys (but not "
            "one that the instruction is about)"
        )
    return mark | (COLOR_WORDS.index(content.color) + 1) << CONTENTS_SHIFT
