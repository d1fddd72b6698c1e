"""The registered grid worlds: a table of ids, and how a row becomes a POMDP."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from envs_jax.minigrid import babyai
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.late_hands import LateHandsWorld
from envs_jax.minigrid.missions import GO_TO_LENGTH, MISSION_LENGTH
from envs_jax.minigrid.obstacles import ObstacleTask, ObstacleWorld
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.samplers.babyai.level import LevelSampler
from envs_jax.minigrid.samplers.babyai.one_room import GoToSampler
from envs_jax.minigrid.samplers.babyai.put_next import PutNextSampler
from envs_jax.minigrid.samplers.crossing import CrossingSampler
from envs_jax.minigrid.samplers.dist_shift import DistShiftSampler
from envs_jax.minigrid.samplers.door_key import DoorKeySampler
from envs_jax.minigrid.samplers.dynamic_obstacles import DynamicObstaclesSampler
from envs_jax.minigrid.samplers.empty import EmptySampler
from envs_jax.minigrid.samplers.four_rooms import FourRoomsSampler
from envs_jax.minigrid.samplers.go_to_door import GoToDoorSampler
from envs_jax.minigrid.samplers.key_corridor import KeyCorridorSampler
from envs_jax.minigrid.samplers.lava_gap import LavaGapSampler
from envs_jax.minigrid.samplers.locked_room import LockedRoomSampler
from envs_jax.minigrid.samplers.memory import MemorySampler
from envs_jax.minigrid.samplers.multi_room import MultiRoomSampler
from envs_jax.minigrid.samplers.objects import Errand, ObjectsSampler
from envs_jax.minigrid.samplers.obstructed_maze import ObstructedMazeSampler
from envs_jax.minigrid.samplers.playground import PlaygroundSampler
from envs_jax.minigrid.samplers.red_blue_doors import RedBlueDoorsSampler
from envs_jax.minigrid.samplers.unlock import UnlockSampler
from envs_jax.minigrid.samplers.wfc import LOOKS, SIZE, WFCSampler
from envs_jax.minigrid.sensors import VIEW_SIZE, DirectionSensor, MissionSensor
from envs_jax.minigrid.tasks import GoalTask, GoToTask, InstructionTask
from envs_jax.minigrid.views import TILE_SIZE, image_sensor
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
    mission_length: int = MISSION_LENGTH,
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    tile_size: int = TILE_SIZE,
) -> POMDP:
    """Composes a grid world with MiniGrid's three observations: image, direction and mission.

    Args:
      task: reward and end of an episode.
      sampler: where episodes begin.
      width: cells along x.
      height: cells along y.
      environment: the dynamics; by default those that most worlds share.
      see_through_walls: whether walls and shut doors hide nothing.
      mission_length: words that the longest mission needs.
      observation: what the image shows, see `views.image_sensor`.
      view_size: cells along a side of the agent's view.
      tile_size: pixels of a cell's edge, where the image is of pixels.

    Raises:
      JaxactError: no such observation, or a size that cannot be.
    """
    sensors = {
        "image": image_sensor(
            observation,
            width,
            height,
            see_through_walls=see_through_walls,
            view_size=view_size,
            tile_size=tile_size,
        ),
        "direction": DirectionSensor(),
        "mission": MissionSensor(mission_length),
    }
    return POMDP(environment or GridWorld(width, height), task, sampler, sensors)


class _World(NamedTuple):
    """A row of the table of worlds; the task is yet to be told width and height."""

    sampler: TaskSampler
    width: int
    height: int
    task: Callable[[int, int], Task] = GoalTask
    environment: Environment | None = None
    see_through_walls: bool = False
    mission_length: int = MISSION_LENGTH


def _grid_world(
    world: _World,
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    tile_size: int = TILE_SIZE,
) -> POMDP:
    return compose(
        world.task(world.width, world.height),
        world.sampler,
        world.width,
        world.height,
        environment=world.environment,
        see_through_walls=world.see_through_walls,
        mission_length=world.mission_length,
        observation=observation,
        view_size=view_size,
        tile_size=tile_size,
    )


# Sizes of the worlds whose id ends in -{size}x{size}-v0, and crossings as (size, rivers).
_EMPTY_SIZES = (5, 6, 8, 16)
_EMPTY_RANDOM_SIZES = (5, 6)
_DOOR_KEY_SIZES = (5, 6, 8, 16)
_CROSSINGS = ((9, 1), (9, 2), (9, 3), (11, 5))
# Rooms and their largest size. The four in N4-S5-v0 were always six.
_MULTI_ROOMS = {"N2-S4-v0": (2, 4), "N4-S5-v0": (6, 5), "N4-S5-v1": (4, 5), "N6-v0": (6, 10)}
# What to do, size, number of objects, horizon. That of PutNear is in proportion to the side.
_ERRANDS: dict[str, tuple[Errand, int, int, int]] = {
    "Fetch-5x5-N2-v0": ("fetch", 5, 2, 125),
    "Fetch-6x6-N2-v0": ("fetch", 6, 2, 180),
    "Fetch-8x8-N3-v0": ("fetch", 8, 3, 320),
    "GoToObject-6x6-N2-v0": ("go to", 6, 2, 180),
    "GoToObject-8x8-N2-v0": ("go to", 8, 2, 320),
    "PutNear-6x6-N2-v0": ("put near", 6, 2, 30),
    "PutNear-8x8-N3-v0": ("put near", 8, 3, 40),
}
# Size and number of obstacles.
_OBSTACLES = {
    "5x5": (5, 2),
    "6x6": (6, 3),
    "8x8": (8, 4),
    "16x16": (16, 8),
    "Random-5x5": (5, 2),
    "Random-6x6": (6, 3),
}
# Room size and rows.
_KEY_CORRIDORS = ((3, 1), (3, 2), (3, 3), (4, 3), (5, 3), (6, 3))
_UNLOCKS = {
    "Unlock-v0": UnlockSampler(288),
    "UnlockPickup-v0": UnlockSampler(288, pickup=True),
    "BlockedUnlockPickup-v0": UnlockSampler(576, pickup=True, blocked=True),
}
# Open quarters, horizon, room of the agent, keys in boxes, balls before locked doors.
_OBSTRUCTED_MAZES: dict[str, tuple[int, int, tuple[int, int], bool, bool]] = {
    "1Dl": (0, 288, (0, 0), False, False),
    "1Dlh": (0, 288, (0, 0), True, False),
    "1Dlhb": (0, 288, (0, 0), True, True),
    "2Dl": (1, 576, (2, 1), False, False),
    "2Dlh": (1, 576, (2, 1), True, False),
    "2Dlhb": (1, 576, (2, 1), True, True),
    "1Q": (1, 720, (1, 1), True, True),
    "2Q": (2, 1584, (2, 1), True, True),
    "Full": (4, 3600, (1, 1), True, True),
}
# Those of which there is a version 1, in which keys are never lost.
_OBSTRUCTED_MAZES_V1 = ("2Dlhb", "1Q", "2Q", "Full")


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
    for look in LOOKS:
        worlds[f"WFC-{look}-v0"] = _World(WFCSampler(look, 20 * SIZE), SIZE, SIZE)
    return worlds


def _rule_worlds() -> dict[str, _World]:
    """Returns the worlds in which there is something else to do, by name."""
    worlds = {}
    worlds["Playground-v0"] = _World(PlaygroundSampler(100), 19, 19, RuleTask)
    for name, (errand, size, objects, max_steps) in _ERRANDS.items():
        sampler = ObjectsSampler(size, objects, max_steps, errand)
        worlds[name] = _World(sampler, size, size, RuleTask, see_through_walls=True)
    for size in (5, 6, 8):
        doors = GoToDoorSampler(size, 4 * size**2)
        name = f"GoToDoor-{size}x{size}-v0"
        worlds[name] = _World(doors, size, size, RuleTask, see_through_walls=True)
    for size in (6, 8):
        in_turn = RedBlueDoorsSampler(size, 20 * size**2)
        worlds[f"RedBlueDoors-{size}x{size}-v0"] = _World(in_turn, 2 * size, size, RuleTask)
    for size, name in ((7, ""), (9, ""), (11, ""), (13, ""), (13, "Random"), (17, "Random")):
        memory = MemorySampler(size, 5 * size**2, name == "Random")
        hands_free = GridWorld(size, size, pickup_toggles=True)
        worlds[f"MemoryS{size}{name}-v0"] = _World(memory, size, size, RuleTask, hands_free)
    return worlds


def _obstacle_worlds() -> dict[str, _World]:
    """Returns the worlds with balls that roam, by name."""
    worlds = {}
    for name, (size, obstacles) in _OBSTACLES.items():
        random_start = name.startswith("Random")
        sampler = DynamicObstaclesSampler(size, obstacles, 4 * size**2, random_start)
        environment = ObstacleWorld(size, size)
        worlds[f"Dynamic-Obstacles-{name}-v0"] = _World(
            sampler, size, size, ObstacleTask, environment, see_through_walls=True
        )
    return worlds


def _room_grid_worlds() -> dict[str, _World]:
    """Returns the worlds with a grid of rooms in which there is no goal square, by name."""
    worlds = {name: _World(sampler, 11, 6, RuleTask) for name, sampler in _UNLOCKS.items()}
    for size, rows in _KEY_CORRIDORS:
        corridor = KeyCorridorSampler(size, rows, 30 * size**2)
        extent = corridor.grid.width, corridor.grid.height
        worlds[f"KeyCorridorS{size}R{rows}-v0"] = _World(corridor, *extent, RuleTask)
    for name, options in _OBSTRUCTED_MAZES.items():
        for version in (0, 1) if name in _OBSTRUCTED_MAZES_V1 else (0,):
            maze = ObstructedMazeSampler(*options, keys_last=version == 1)
            extent = maze.grid.width, maze.grid.height
            worlds[f"ObstructedMaze-{name}-v{version}"] = _World(maze, *extent, RuleTask)
    return worlds


def _one_room_world(sampler: GoToSampler) -> _World:
    size = sampler.size
    return _World(sampler, size, size, GoToTask, mission_length=GO_TO_LENGTH)


def _level_world(sampler: LevelSampler) -> _World:
    extent = sampler.grid.width, sampler.grid.height
    late_hands = isinstance(sampler, PutNextSampler) and sampler.start_carrying
    return _World(
        sampler,
        *extent,
        task=GoToTask if sampler.is_go_to else partial(InstructionTask, beliefs=sampler.beliefs),
        environment=LateHandsWorld(*extent) if late_hands else None,
        mission_length=sampler.mission_length,
    )


def register_all() -> None:
    """Registers every grid world that has one of Farama's ids.

    All take the options `observation`, `view_size` and `tile_size`, see `compose`.
    """
    worlds = _goal_worlds() | _rule_worlds() | _room_grid_worlds() | _obstacle_worlds()
    for name, world in worlds.items():
        register(f"MiniGrid-{name}", partial(_grid_world, world))
    for name, go_to_sampler in babyai.one_room_levels().items():
        register(f"BabyAI-{name}", partial(_grid_world, _one_room_world(go_to_sampler)))
    for name, level_sampler in babyai.levels().items():
        register(f"BabyAI-{name}", partial(_grid_world, _level_world(level_sampler)))
