"""The registered grid worlds: a table of ids, and how a row becomes a POMDP."""

from __future__ import annotations

from functools import partial

from envs_jax.minigrid import babyai
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.late_hands import LateHandsWorld
from envs_jax.minigrid.missions import GO_TO_LENGTH, MISSION_LENGTH
from envs_jax.minigrid.samplers.babyai.level import LevelSampler
from envs_jax.minigrid.samplers.babyai.one_room import GoToSampler
from envs_jax.minigrid.samplers.babyai.put_next import PutNextSampler
from envs_jax.minigrid.samplers.crossing import CrossingSampler
from envs_jax.minigrid.samplers.door_key import DoorKeySampler
from envs_jax.minigrid.samplers.empty import EmptySampler
from envs_jax.minigrid.samplers.four_rooms import FourRoomsSampler
from envs_jax.minigrid.sensors import VIEW_SIZE, DirectionSensor, ImageSensor, MissionSensor
from envs_jax.minigrid.tasks import GoalTask, GoToTask, InstructionTask
from envs_jax.registry import register
from jaxact.pomdp import POMDP, Environment, Task, TaskSampler


def compose(
    task: Task,
    sampler: TaskSampler,
    width: int,
    height: int,
    *,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
    mission_length: int = MISSION_LENGTH,
    environment: Environment | None = None,
) -> POMDP:
    """Composes a grid world with MiniGrid's three observations: image, direction and mission.

    Args:
      task: reward and end of an episode.
      sampler: where episodes begin.
      width: cells along x.
      height: cells along y.
      see_through_walls: whether walls and shut doors hide nothing.
      view_size: cells along a side of the agent's view.
      mission_length: words that the longest mission needs.
      environment: the dynamics; by default those that most worlds share.

    Raises:
      JaxactError: `view_size` is not odd, or not in 3 … 7.
    """
    sensors = {
        "image": ImageSensor(width, height, view_size, see_through_walls),
        "direction": DirectionSensor(),
        "mission": MissionSensor(mission_length),
    }
    return POMDP(environment or GridWorld(width, height), task, sampler, sensors)


def _goal_world(
    sampler: EmptySampler | FourRoomsSampler | DoorKeySampler | CrossingSampler,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
) -> POMDP:
    size = sampler.size
    return compose(
        GoalTask(size, size),
        sampler,
        size,
        size,
        see_through_walls=see_through_walls,
        view_size=view_size,
    )


def _one_room_world(sampler: GoToSampler, view_size: int = VIEW_SIZE) -> POMDP:
    size = sampler.size
    return compose(
        GoToTask(size, size),
        sampler,
        size,
        size,
        view_size=view_size,
        mission_length=GO_TO_LENGTH,
    )


def _level_world(sampler: LevelSampler, view_size: int = VIEW_SIZE) -> POMDP:
    size = sampler.grid.width, sampler.grid.height
    task = GoToTask(*size) if sampler.is_go_to else InstructionTask(*size, sampler.beliefs)
    late_hands = isinstance(sampler, PutNextSampler) and sampler.start_carrying
    return compose(
        task,
        sampler,
        *size,
        view_size=view_size,
        mission_length=sampler.mission_length,
        environment=LateHandsWorld(*size) if late_hands else None,
    )


# Sizes of the worlds whose id ends in -{size}x{size}-v0, and crossings as (size, rivers).
_EMPTY_SIZES = (5, 6, 8, 16)
_EMPTY_RANDOM_SIZES = (5, 6)
_DOOR_KEY_SIZES = (5, 6, 8, 16)
_CROSSINGS = ((9, 1), (9, 2), (9, 3), (11, 5))


def register_all() -> None:
    """Registers every grid world under Farama's id; all take the option `view_size`."""
    goals: dict[str, EmptySampler | FourRoomsSampler | DoorKeySampler | CrossingSampler] = {}
    for size in _EMPTY_SIZES:
        goals[f"Empty-{size}x{size}-v0"] = EmptySampler(size, 4 * size**2)
    for size in _EMPTY_RANDOM_SIZES:
        goals[f"Empty-Random-{size}x{size}-v0"] = EmptySampler(size, 4 * size**2, True)
    for size in _DOOR_KEY_SIZES:
        goals[f"DoorKey-{size}x{size}-v0"] = DoorKeySampler(size, 10 * size**2)
    for size, rivers in _CROSSINGS:
        for name, walls in (("LavaCrossing", False), ("SimpleCrossing", True)):
            sampler = CrossingSampler(size, rivers, 4 * size**2, walls)
            goals[f"{name}S{size}N{rivers}-v0"] = sampler
    goals["FourRooms-v0"] = FourRoomsSampler(19, 100)

    for name, goal_sampler in goals.items():
        see_through = isinstance(goal_sampler, EmptySampler)
        register(f"MiniGrid-{name}", partial(_goal_world, goal_sampler, see_through))
    for name, go_to_sampler in babyai.one_room_levels().items():
        register(f"BabyAI-{name}", partial(_one_room_world, go_to_sampler))
    for name, level_sampler in babyai.levels().items():
        register(f"BabyAI-{name}", partial(_level_world, level_sampler))
