"""The registered grid worlds: a table of ids, and how a row becomes a POMDP."""

from __future__ import annotations

from functools import partial

from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.late_hands import LateHandsWorld
from envs_jax.minigrid.missions import GO_TO_LENGTH, MISSION_LENGTH
from envs_jax.minigrid.samplers.babyai import GoToSampler, Target
from envs_jax.minigrid.samplers.crossing import CrossingSampler
from envs_jax.minigrid.samplers.door_key import DoorKeySampler
from envs_jax.minigrid.samplers.empty import EmptySampler
from envs_jax.minigrid.samplers.four_rooms import FourRoomsSampler
from envs_jax.minigrid.sensors import VIEW_SIZE, DirectionSensor, ImageSensor, MissionSensor
from envs_jax.minigrid.tasks import GoalTask, GoToTask
from envs_jax.registry import register
from jaxact.pomdp import POMDP, Task, TaskSampler


def compose(
    task: Task,
    sampler: TaskSampler,
    width: int,
    height: int,
    *,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
    mission_length: int = MISSION_LENGTH,
    late_hands: bool = False,
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
      late_hands: whether the agent is given an object after its first observation.

    Raises:
      JaxactError: `view_size` is not odd, or not in 3 … 7.
    """
    sensors = {
        "image": ImageSensor(width, height, view_size, see_through_walls),
        "direction": DirectionSensor(),
        "mission": MissionSensor(mission_length),
    }
    world = LateHandsWorld if late_hands else GridWorld
    return POMDP(world(width, height), task, sampler, sensors)


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


def _go_to_world(sampler: GoToSampler, view_size: int = VIEW_SIZE) -> POMDP:
    size = sampler.size
    return compose(
        GoToTask(size, size),
        sampler,
        size,
        size,
        view_size=view_size,
        mission_length=GO_TO_LENGTH,
    )


# BabyAI's one-room GoTo levels: room size, objects in all, target.
_GO_TO: dict[str, tuple[int, int, Target]] = {
    "GoToRedBallGrey-v0": (8, 8, "red ball among grey"),
    "GoToRedBall-v0": (8, 8, "red ball"),
    "GoToRedBallNoDists-v0": (8, 1, "red ball"),
    "GoToRedBlueBall-v0": (8, 8, "red or blue ball"),
    "GoToObj-v0": (8, 1, "any"),
    "GoToObjS4-v0": (4, 1, "any"),
    "GoToObjS6-v1": (6, 1, "any"),
    "GoToLocal-v0": (8, 8, "any"),
    "GoToLocalS5N2-v0": (5, 2, "any"),
    "GoToLocalS6N2-v0": (6, 2, "any"),
    "GoToLocalS6N3-v0": (6, 3, "any"),
    "GoToLocalS6N4-v0": (6, 4, "any"),
    "GoToLocalS7N4-v0": (7, 4, "any"),
    "GoToLocalS7N5-v0": (7, 5, "any"),
    "GoToLocalS8N2-v0": (8, 2, "any"),
    "GoToLocalS8N3-v0": (8, 3, "any"),
    "GoToLocalS8N4-v0": (8, 4, "any"),
    "GoToLocalS8N5-v0": (8, 5, "any"),
    "GoToLocalS8N6-v0": (8, 6, "any"),
    "GoToLocalS8N7-v0": (8, 7, "any"),
}

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
    for name, (size, objects, target) in _GO_TO.items():
        go_to_sampler = GoToSampler(size, objects, size**2, target)
        register(f"BabyAI-{name}", partial(_go_to_world, go_to_sampler))
