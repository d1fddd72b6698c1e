"""The registered grid worlds: a table of ids, and how a row becomes a POMDP."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.samplers.babyai import GoToSampler, Target
from envs_jax.minigrid.samplers.crossing import CrossingSampler
from envs_jax.minigrid.samplers.dist_shift import DistShiftSampler
from envs_jax.minigrid.samplers.door_key import DoorKeySampler
from envs_jax.minigrid.samplers.empty import EmptySampler
from envs_jax.minigrid.samplers.four_rooms import FourRoomsSampler
from envs_jax.minigrid.samplers.lava_gap import LavaGapSampler
from envs_jax.minigrid.samplers.locked_room import LockedRoomSampler
from envs_jax.minigrid.samplers.multi_room import MultiRoomSampler
from envs_jax.minigrid.samplers.playground import PlaygroundSampler
from envs_jax.minigrid.sensors import VIEW_SIZE, DirectionSensor, ImageSensor, MissionSensor
from envs_jax.minigrid.tasks import GoalTask, InstructionTask
from envs_jax.registry import register
from jaxact.pomdp import POMDP, Environment, Task, TaskSampler


def compose(
    task: Task,
    sampler: TaskSampler,
    width: int,
    height: int,
    *,
    environment: Environment | None = None,
    see_through_walls: bool = False,
    view_size: int = VIEW_SIZE,
) -> POMDP:
    """Composes a grid world with MiniGrid's three observations: image, direction and mission.

    Without an `environment` of its own the world has the dynamics that most worlds share.

    Raises:
      JaxactError: `view_size` is not odd, or not in 3 … 7.
    """
    sensors = {
        "image": ImageSensor(width, height, view_size, see_through_walls),
        "direction": DirectionSensor(),
        "mission": MissionSensor(),
    }
    return POMDP(environment or GridWorld(width, height), task, sampler, sensors)


class _World(NamedTuple):
    """A row of the table of MiniGrid's own worlds."""

    sampler: TaskSampler
    width: int
    height: int
    task: type[GoalTask] | type[RuleTask] = GoalTask
    environment: Environment | None = None
    see_through_walls: bool = False


def _grid_world(world: _World, view_size: int = VIEW_SIZE) -> POMDP:
    return compose(
        world.task(world.width, world.height),
        world.sampler,
        world.width,
        world.height,
        environment=world.environment,
        see_through_walls=world.see_through_walls,
        view_size=view_size,
    )


def _go_to_world(sampler: GoToSampler, view_size: int = VIEW_SIZE) -> POMDP:
    size = sampler.size
    return compose(InstructionTask(size, size), sampler, size, size, view_size=view_size)


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
# Rooms and their largest size. The four in N4-S5-v0 were always six.
_MULTI_ROOMS = {"N2-S4-v0": (2, 4), "N4-S5-v0": (6, 5), "N4-S5-v1": (4, 5), "N6-v0": (6, 10)}


def _goal_worlds() -> dict[str, _World]:
    """Returns the worlds in which there is a goal square to reach, by name."""
    worlds = {}
    for size in _EMPTY_SIZES:
        sampler = EmptySampler(size, 4 * size**2)
        worlds[f"Empty-{size}x{size}-v0"] = _World(sampler, size, size, see_through_walls=True)
    for size in _EMPTY_RANDOM_SIZES:
        sampler = EmptySampler(size, 4 * size**2, True)
        name = f"Empty-Random-{size}x{size}-v0"
        worlds[name] = _World(sampler, size, size, see_through_walls=True)
    for number, strip in ((1, 2), (2, 5)):
        shifted = DistShiftSampler(strip, 252)
        worlds[f"DistShift{number}-v0"] = _World(shifted, 9, 7, see_through_walls=True)
    for size in (5, 6, 7):
        worlds[f"LavaGapS{size}-v0"] = _World(LavaGapSampler(size, 4 * size**2), size, size)
    for size in _DOOR_KEY_SIZES:
        worlds[f"DoorKey-{size}x{size}-v0"] = _World(DoorKeySampler(size, 10 * size**2), size, size)
    for size, rivers in _CROSSINGS:
        for name, walls in (("LavaCrossing", False), ("SimpleCrossing", True)):
            crossing = CrossingSampler(size, rivers, 4 * size**2, walls)
            worlds[f"{name}S{size}N{rivers}-v0"] = _World(crossing, size, size)
    worlds["FourRooms-v0"] = _World(FourRoomsSampler(19, 100), 19, 19)
    for name, (rooms, largest) in _MULTI_ROOMS.items():
        worlds[f"MultiRoom-{name}"] = _World(MultiRoomSampler(rooms, largest, 20 * rooms), 25, 25)
    worlds["LockedRoom-v0"] = _World(LockedRoomSampler(190), 19, 19)
    return worlds


def _rule_worlds() -> dict[str, _World]:
    """Returns the worlds in which there is something else to do, by name."""
    worlds = {}
    worlds["Playground-v0"] = _World(PlaygroundSampler(100), 19, 19, RuleTask)
    return worlds


def register_all() -> None:
    """Registers every grid world under Farama's id; all take the option `view_size`."""
    for name, world in (_goal_worlds() | _rule_worlds()).items():
        register(f"MiniGrid-{name}", partial(_grid_world, world))
    for name, (size, objects, target) in _GO_TO.items():
        sampler = GoToSampler(size, objects, size**2, target)
        register(f"BabyAI-{name}", partial(_go_to_world, sampler))
