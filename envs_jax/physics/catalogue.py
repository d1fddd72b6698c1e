"""How physics worlds are put together: Gymnasium's and those of our own robots, and their ids."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from envs_jax.houses.camera import Camera
from envs_jax.houses.vision import DepthScale, DepthSensor, RGBSensor
from envs_jax.physics.arm_point_nav import (
    ArmPointNav,
    ArmSensor,
    TablesSensor,
    TwoTables,
    WaysSensor,
)
from envs_jax.physics.cameras import RoverCamera
from envs_jax.physics.environment import Physics
from envs_jax.physics.hand import GRIP, hand
from envs_jax.physics.locomotion import (
    Balance,
    BalanceSensor,
    BalanceTwo,
    NoisyStart,
    RunForward,
    RunUpright,
    WholeBodySensor,
)
from envs_jax.physics.manipulation import (
    IN_THE_AIR,
    ON_THE_TABLE,
    GapSensor,
    MoveObject,
    OnTable,
)
from envs_jax.physics.mobile_arm import mobile_arm
from envs_jax.physics.models import gymnasium_asset
from envs_jax.physics.navigation import (
    ClutteredArena,
    GoalSensor,
    LidarSensor,
    PointNav,
    SpeedSensor,
)
from envs_jax.physics.reach import AnyPose, Reach, TargetSensor, arm
from envs_jax.physics.reacher import ReacherSensor, ReacherStart, Touch
from envs_jax.physics.rover import BODY, DRIVES, rover
from envs_jax.physics.sensors import JointSensor
from envs_jax.registry import register
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Sensor, Task, TaskSampler

# Degrees, of the rover's camera.
_FIELD_OF_VIEW = 79.0


@dataclass(frozen=True)
class _Body:
    """A model of Gymnasium's, and what is made of it.

    Attributes:
      asset: the model's file.
      substeps: of the simulation in a step.
      task: of a world.
      start: of a world and a horizon.
      sensor: of a world.
      horizon: steps.
      extras: what of MuJoCo's data is kept in the state.
      solver: to take in place of the file's, which MJX does not have.
    """

    asset: str
    substeps: int
    task: Callable[[Physics], Task]
    start: Callable[[Physics, int], TaskSampler]
    sensor: Callable[[Physics], Sensor]
    horizon: int = 1000
    extras: tuple[str, ...] = ()
    solver: str | None = None


def _noisy(position: float, velocity: float, normal: bool = False) -> Callable[..., TaskSampler]:
    return lambda world, horizon: NoisyStart(world, position, velocity, normal, horizon)


def _runs(threshold: float, **numbers: float | tuple[float, float]) -> Callable[[Physics], Task]:
    return lambda world: RunForward(world, threshold, **numbers)  # type: ignore[arg-type]


BODIES = {
    "InvertedPendulum": _Body(
        "inverted_pendulum.xml", 2, lambda _: Balance(), _noisy(0.01, 0.01), JointSensor
    ),
    "InvertedDoublePendulum": _Body(
        "inverted_double_pendulum.xml",
        5,
        lambda _: BalanceTwo(),
        _noisy(0.1, 0.1, normal=True),
        lambda _: BalanceSensor(),
    ),
    "Reacher": _Body("reacher.xml", 2, Touch, ReacherStart, ReacherSensor, horizon=50),
    "Swimmer": _Body(
        "swimmer.xml", 4, _runs(360.0, control=1e-4), _noisy(0.1, 0.1), partial(JointSensor, skip=2)
    ),
    "HalfCheetah": _Body(
        "half_cheetah.xml",
        5,
        _runs(4800.0, control=0.1),
        _noisy(0.1, 0.1, normal=True),
        partial(JointSensor, skip=1),
    ),
    "Hopper": _Body(
        "hopper.xml",
        4,
        _runs(
            3800.0,
            healthy=1.0,
            height=(0.7, float("inf")),
            angle=(-0.2, 0.2),
            others=(-100.0, 100.0),
        ),
        _noisy(5e-3, 5e-3),
        partial(JointSensor, skip=1, fastest=10.0),
    ),
    "Walker2d": _Body(
        "walker2d_v5.xml",
        4,
        # Gymnasium has no threshold for it.
        _runs(float("inf"), healthy=1.0, height=(0.8, 2.0), angle=(-1.0, 1.0)),
        _noisy(5e-3, 5e-3),
        partial(JointSensor, skip=1, fastest=10.0),
    ),
    "Ant": _Body(
        "ant.xml",
        5,
        lambda world: RunUpright(world, 6000.0, height=(0.2, 1.0), force_bound=1.0),
        _noisy(0.1, 0.1, normal=True),
        partial(WholeBodySensor, force_bound=1.0),
        extras=("cfrc_ext",),
    ),
    "Humanoid": _Body(
        "humanoid.xml",
        5,
        # Gymnasium has no threshold for it.
        lambda world: RunUpright(
            world,
            float("inf"),
            height=(1.0, 2.0),
            forward=1.25,
            control=0.1,
            contact=5e-7,
            cost_bound=10.0,
            healthy=5.0,
            whole=True,
        ),
        _noisy(0.01, 0.01),
        WholeBodySensor,
        extras=("cinert", "cvel", "qfrc_actuator", "cfrc_ext", "subtree_com"),
        solver="Newton",
    ),
}


def gymnasium_body(name: str, *, horizon: int | None = None) -> POMDP:
    """Builds one of Gymnasium's MuJoCo environments, version 5, on MJX.

    Args:
      name: one of `BODIES`.
      horizon: steps; by default Gymnasium's.

    Returns:
      The POMDP; its observation has the "joints", Gymnasium's numbers in their order.

    Raises:
      JaxactError: Gymnasium, whose models these are, is not installed.
    """
    body = BODIES[name]
    source = gymnasium_asset(body.asset)
    if body.solver:
        text = Path(source).read_text(encoding="utf-8")
        source = re.sub(r'solver="\w+"', f'solver="{body.solver}"', text)
    world = Physics(source, body.substeps, extras=body.extras)
    start = body.start(world, body.horizon if horizon is None else horizon)
    return POMDP(world, body.task(world), start, {"joints": body.sensor(world)})


def point_nav(
    *,
    control: str = "moves",
    observation: tuple[str, ...] = ("lidar",),
    resolution: int = 32,
    horizon: int | None = None,
) -> POMDP:
    """Builds PointNav for a rover with two driven wheels among boxes.

    Args:
      control: "moves" of 0.25 m and turns of 30°, or "velocities", two numbers.
      observation: what is sensed besides the goal and the speed, of "lidar", "depth" and "rgb".
      resolution: pixels of a picture's side.
      horizon: steps; by default 100 moves, or 300 steps of 0.2 s.

    Raises:
      JaxactError: there is no such control or observation.
    """
    if control not in DRIVES:
        raise unknown("control of the rover", control, DRIVES)
    if isinstance(observation, str):
        raise JaxactError(f"observation is a sequence of names, as ({observation!r},)")
    drive = DRIVES[control]
    world, task = rover(drive), PointNav(drive)
    if horizon is None:
        horizon = 100 if control == "moves" else 300
    camera = Camera(resolution, resolution, _FIELD_OF_VIEW)
    choice: dict[str, Sensor] = {
        "lidar": LidarSensor(),
        "depth": RoverCamera(DepthSensor(camera, BODY, DepthScale(0.0, 5.0))),
        "rgb": RoverCamera(RGBSensor(camera, BODY)),
    }
    sensors: dict[str, Sensor] = {"goal": GoalSensor(), "speed": SpeedSensor()}
    for name in observation:
        if name not in choice:
            raise unknown("observation of the rover", name, choice)
        sensors[name] = choice[name]
    return POMDP(world, task, ClutteredArena(world, task, horizon=horizon), sensors)


def reach(*, robot: str = "arm", horizon: int | None = None) -> POMDP:
    """Builds Reach for an arm of three joints, moved by torques, or for the hand over a table.

    Args:
      robot: "arm" or "hand".
      horizon: steps; by default 100 of 40 ms for the arm, and 500 of 20 ms for the hand.

    Raises:
      JaxactError: there is no such robot.
    """
    sampler: TaskSampler
    if robot == "arm":
        world = arm()
        task = Reach(world)
        sampler = AnyPose(world, task, 100 if horizon is None else horizon)
    elif robot == "hand":
        world = hand()
        task = Reach(world, GRIP)
        sampler = OnTable(world, task, horizon=500 if horizon is None else horizon)
    else:
        raise unknown("robot that reaches", robot, ("arm", "hand"))
    joints = JointSensor(world, on_circle=robot == "arm")
    sensors: dict[str, Sensor] = {"joints": joints, "target": TargetSensor(task)}
    return POMDP(world, task, sampler, sensors)


def push(*, horizon: int = 500) -> POMDP:
    """Builds Push: the hand is to bring the cube within 0.05 m of a place on the table.

    Args:
      horizon: steps of 20 ms.
    """
    world = hand()
    task = MoveObject(world)
    return _move_object(task, OnTable(world, task, targets=ON_THE_TABLE, horizon=horizon))


def pick_place(*, horizon: int = 500) -> POMDP:
    """Builds PickPlace: the hand is to bring the cube within 0.07 m of a place in the air.

    Args:
      horizon: steps of 20 ms.
    """
    world = hand()
    task = MoveObject(world, radius=0.07, lift=0.5)
    return _move_object(task, OnTable(world, task, targets=IN_THE_AIR, horizon=horizon))


def _move_object(task: MoveObject, sampler: OnTable) -> POMDP:
    world = task.world
    sensors: dict[str, Sensor] = {
        "joints": JointSensor(world),
        "gap": GapSensor(task),
        "target": TargetSensor(task),
    }
    return POMDP(world, task, sampler, sensors)


def arm_point_nav(*, easy: bool = False, disturbance: float = 0.0, horizon: int = 200) -> POMDP:
    """Builds ManipulaTHOR's ArmPointNav for a robot with an arm between two tables.

    Args:
      easy: the object is taken by itself where the hand is near it, and the episode ends by itself
        at the goal.
      disturbance: cost of each metre by which other balls are moved.
      horizon: steps.
    """
    world = mobile_arm(easy=easy)
    task = ArmPointNav(world, disturbance=disturbance)
    sensors: dict[str, Sensor] = {
        "ways": WaysSensor(task),
        "arm": ArmSensor(),
        "tables": TablesSensor(),
    }
    return POMDP(world, task, TwoTables(world, task, horizon), sensors)


def _register(name: str) -> None:
    def build(*, horizon: int | None = None) -> POMDP:
        return gymnasium_body(name, horizon=horizon)

    register(f"Physics-{name}-v0", build)


for _name in BODIES:
    _register(_name)
register("Physics-PointNav-v0", point_nav)
register("Physics-Reach-v0", reach)
register("Physics-Push-v0", push)
register("Physics-PickPlace-v0", pick_place)
register("Physics-ArmPointNav-v0", arm_point_nav)
