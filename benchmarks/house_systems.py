"""The systems whose first-person pictures are timed: jaxact's houses, and worlds by their peers.

Of jaxact there are two: PointNav as it is trained, and its camera alone.

Each is started, compiled and warm, by `build`; a peer that is not installed raises `Unsupported`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.env_systems import (
    PHILOX,
    Facts,
    Host,
    JaxactWorld,
    Running,
    Unsupported,
    require,
)

# What jaxact's camera takes; in "rgb 2x2" each pixel is the mean of four rays.
READINGS = ("depth", "instance", "depth+semantic", "rgb", "rgb 2x2")
# Metres of the square that the boxes stand in, and of its ceiling.
_SQUARE, _CEILING = 10.0, 2.5
# One action in so many is "end", so that episodes last a hundred steps on average.
_END = 100
# Houses that episodes are drawn from.
_HOUSES = 128
# ViZDoom's smallest screen.
_DOOM_SCREEN = (120, 160)


@dataclass(frozen=True)
class Job:
    """What is measured.

    Attributes:
      system: a key of `SYSTEMS`.
      reading: one of `READINGS`; peers have their own.
      pixels: edge of a picture.
      boxes: in each of jaxact's houses.
      lanes: worlds side by side; peers have one.
      steps: pictures of each lane in one repeat.
      seed: of everything random.
      devices: that the lanes are sharded over.
    """

    system: str
    reading: str
    pixels: int
    boxes: int
    lanes: int
    steps: int
    seed: int
    devices: int


@dataclass(frozen=True)
class System:
    """One system.

    Attributes:
      build: starts it, compiled and warm; its facts name what its line has beyond the rate.
      observation: what is consumed at every step.
      does: what a step does beside taking a picture.
      share: of the steps asked for; slow systems need fewer for a repeat as long.
    """

    build: Callable[[Job], tuple[Running, Facts]]
    observation: str
    does: str
    share: float = 1.0


def _compile(world: Any, job: Job) -> tuple[Running, Facts]:
    from benchmarks.jax_loop import compile_loop

    loop = compile_loop(world, job.seed, PHILOX, job.lanes, job.steps, job.devices)
    used = loop.program.memory_analysis()
    # The loop's state is donated: it is held once.
    held = used.argument_size_in_bytes + used.temp_size_in_bytes
    facts = {"reading": job.reading, "boxes": job.boxes, "lanes": job.lanes}
    facts |= {"memory_per_lane_kb": round(held / (job.lanes // job.devices) / 1024, 1)}
    return loop, facts


def _sensors(reading: str, camera: Any, body: Any) -> dict[str, Any]:
    """Returns the sensors of a reading."""
    from envs_jax.houses import vision

    makers: dict[str, Callable[[], Any]] = {
        "depth": lambda: vision.DepthSensor(camera, body, vision.HABITAT_DEPTH),
        "instance": lambda: vision.InstanceSensor(camera, body),
        "semantic": lambda: vision.SemanticSensor(camera, body),
        "rgb": lambda: vision.RGBSensor(camera, body),
        "rgb 2x2": lambda: vision.RGBSensor(camera, body, rays=2),
    }
    return {name: makers[name]() for name in reading.split("+")}


def _point_nav(job: Job) -> tuple[Running, Facts]:
    return _compile(PointNavWorld(job), job)


def _camera(job: Job) -> tuple[Running, Facts]:
    return _compile(CameraWorld(job), job)


class PointNavWorld(JaxactWorld):
    """RoboTHOR's PointNav in apartments, with the episode queues that training uses."""

    def __init__(self, job: Job) -> None:
        import envs_jax
        from envs_jax.houses.bank import GeneratedScenes
        from envs_jax.houses.catalogue import PLATFORMS
        from envs_jax.houses.generator import APARTMENT
        from jaxact.errors import JaxactError
        from jaxact.spaces import Discrete

        try:
            style = replace(APARTMENT, boxes=job.boxes)
        except JaxactError as error:
            raise Unsupported(str(error)) from error
        pomdp = envs_jax.make(
            "RoboTHOR-PointNav-v0", observation=(), scenes=GeneratedScenes(style, _HOUSES)
        )
        camera, body = PLATFORMS["robothor"].camera(job.pixels), pomdp.environment.body
        sensors = {**pomdp.sensors, **_sensors(job.reading, camera, body)}
        super().__init__(replace(pomdp, sensors=sensors), job.devices)
        self.names = pomdp.environment.action_names
        self.action_space = Discrete((len(self.names) - 1) * _END)

    def step(self, key: Any, state: Any, action: Any) -> tuple[Any, Any, Any, Any]:
        """See `benchmarks.jax_loop.World`; one action in `_END` is "end", the others moves."""
        import jax.numpy as jnp

        moves = [i for i, name in enumerate(self.names) if name != "end"]
        chosen = jnp.asarray(moves, jnp.int32)[action % len(moves)]
        ends = action < self.action_space.n // _END
        chosen = jnp.where(ends, jnp.int32(self.names.index("end")), chosen)
        return super().step(key, state, chosen)


class CameraWorld:
    """Cameras that turn and walk about in houses of boxes, through them if need be."""

    def __init__(self, job: Job) -> None:
        from envs_jax.houses.camera import Camera
        from envs_jax.houses.state import Body
        from jaxact.spaces import Discrete

        camera, body = Camera(job.pixels, job.pixels, 79.0), Body(0.175, 0.9, 0.87)
        self.action_space = Discrete(3)
        self.boxes = job.boxes
        self.random = np.random.default_rng(job.seed)
        self.sensors = _sensors(job.reading, camera, body)

    def begin(self, key: Any, lanes: int) -> tuple[Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        import jax
        import jax.numpy as jnp

        from envs_jax.houses.state import HouseState

        place_key, yaw_key, pitch_key = jax.random.split(key, 3)
        scenes = [self._scene() for _ in range(lanes)]
        pitches = jnp.float32([0, 15, 30])
        state = HouseState(
            scene=jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *scenes),
            position=jax.random.uniform(place_key, (lanes, 2), jnp.float32, 1, _SQUARE - 1),
            yaw=jax.random.uniform(yaw_key, (lanes,), jnp.float32, 0, 360),
            pitch=jax.random.choice(pitch_key, pitches, (lanes,)),
            collided=jnp.zeros(lanes, bool),
            last_action=jnp.zeros(lanes, jnp.int32),
            held=jnp.full(lanes, -1, jnp.int32),
        )
        return state, self._observe(state)

    def age(self, state: Any, share: Any) -> Any:
        """See `benchmarks.jax_loop.World`; these episodes never end."""
        del share
        return state

    def step(self, key: Any, state: Any, action: Any) -> tuple[Any, Any, Any, Any]:
        """See `benchmarks.jax_loop.World`; forward, right or left."""
        import jax.numpy as jnp

        from envs_jax.houses.scene import forward

        del key
        ahead = (0.25 * (action == 0).astype(jnp.float32))[:, None] * forward(state.yaw)
        turn = 30 * (action == 1).astype(jnp.float32) - 30 * (action == 2).astype(jnp.float32)
        state = replace(
            state,
            position=jnp.mod(state.position + ahead, _SQUARE),
            yaw=jnp.mod(state.yaw + turn, 360),
            last_action=action,
        )
        lanes = action.shape[0]
        nothing, never = jnp.zeros(lanes, jnp.float32), jnp.zeros(lanes, bool)
        return state, self._observe(state), nothing, never

    def _observe(self, state: Any) -> Any:
        import jax

        def observe(lane: Any) -> Any:
            return {name: sensor.observe(lane, None) for name, sensor in self.sensors.items()}

        return jax.vmap(observe)(state)

    def _scene(self) -> Any:
        """Half of the boxes are walls, the others furniture turned anyhow."""
        from envs_jax.houses.scene import Scene

        random, count = self.random, self.boxes
        wall = np.arange(count) < count // 2
        center = random.uniform(0, _SQUARE, (count, 3))
        half = random.uniform(0.1, 0.6, (count, 3))
        along = random.uniform(0.5, 2, count)
        sideways = random.random(count) < 0.5
        half[:, 0] = np.where(wall, np.where(sideways, along, 0.06), half[:, 0])
        half[:, 2] = np.where(wall, np.where(sideways, 0.06, along), half[:, 2])
        half[:, 1] = np.where(wall, _CEILING / 2, half[:, 1])
        center[:, 1] = half[:, 1]
        yaw = np.where(wall, 0, random.uniform(0, 2 * np.pi, count))
        turned = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        boxes = np.concatenate([center, half, turned], axis=-1).astype(np.float32)
        no = np.zeros(count, bool)
        return Scene(
            boxes=boxes,
            other_boxes=boxes,
            category=random.integers(3, 40, count).astype(np.int32),
            color=random.random((count, 3)).astype(np.float32),
            openable=no,
            portable=no,
            opened=no,
            rooms=np.float32([[0, 0, _SQUARE, _SQUARE]]),
            room_kind=np.int32([1]),
            ceiling=np.float32(_CEILING),
            surface=np.float32([[0.5, 0.4, 0.3], [0.9, 0.9, 0.9]]),
        )


def _miniworld(job: Job) -> tuple[Running, Facts]:
    require("miniworld")
    loop = MiniWorldLoop(job)
    return loop, {"reading": "rgb", "renderer": loop.renderer}


class MiniWorldLoop(Host):
    """Miniworld: a plain loop over one world; OpenGL without a window, by EGL."""

    def __init__(self, job: Job) -> None:
        import gymnasium
        import pyglet

        # Before anything opens a window; there may be no screen.
        pyglet.options["headless"] = True
        import miniworld  # noqa: F401 (registers the ids)

        super().__init__()
        size = {"obs_width": job.pixels, "obs_height": job.pixels}
        self.env = gymnasium.make("MiniWorld-FourRooms-v0", disable_env_checker=True, **size)
        self.steps = job.steps
        self.random = np.random.default_rng(job.seed)
        self.env.reset(seed=job.seed)
        self.renderer = pyglet.gl.gl_info.get_renderer()
        self.run()

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        begun = time.perf_counter()
        for _ in range(self.steps):
            observation, reward, ended, cut, _ = self.env.step(int(self.random.integers(3)))
            if ended or cut:
                observation, _ = self.env.reset()
            self.consume({"image": observation}, reward, ended or cut)
        return time.perf_counter() - begun


def _vizdoom(job: Job) -> tuple[Running, Facts]:
    require("vizdoom")
    return VizDoomLoop(job), {"reading": "rgb+depth", "pixels": _DOOM_SCREEN}


class VizDoomLoop(Host):
    """ViZDoom, whose renderer is software: a plain loop over one world, at its smallest screen."""

    def __init__(self, job: Job) -> None:
        import vizdoom

        super().__init__()
        game = vizdoom.DoomGame()
        game.load_config(os.path.join(vizdoom.scenarios_path, "my_way_home.cfg"))
        game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
        game.set_screen_format(vizdoom.ScreenFormat.RGB24)
        game.set_depth_buffer_enabled(True)
        game.set_window_visible(False)
        game.set_seed(job.seed)
        game.init()
        self.game, self.steps = game, job.steps
        self.actions = np.eye(game.get_available_buttons_size(), dtype=int).tolist()
        self.random = np.random.default_rng(job.seed)
        self.run()

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        begun = time.perf_counter()
        for _ in range(self.steps):
            reward = self.game.make_action(self.actions[self.random.integers(len(self.actions))])
            finished = self.game.is_episode_finished()
            if finished:
                self.game.new_episode()
            seen = self.game.get_state()
            self.consume(
                {"screen": seen.screen_buffer, "depth": seen.depth_buffer}, reward, finished
            )
        return time.perf_counter() - begun


SYSTEMS = {
    "jaxact": System(
        build=_point_nav,
        observation="the goal, and as said by `reading`",
        does="RoboTHOR's PointNav: collisions, geodesic reward, next episode at the end",
        # Long enough for the queues of episodes to be refilled.
        share=8.0,
    ),
    "camera": System(
        build=_camera,
        observation="as said by `reading`, with floor and ceiling",
        does="a move or a turn, no collisions, no task",
    ),
    "miniworld": System(
        build=_miniworld,
        observation="RGB, MiniWorld-FourRooms-v0",
        does="a step of the world; reset at the end",
        share=4.0,
    ),
    "vizdoom": System(
        build=_vizdoom,
        observation="RGB and depth, MyWayHome, 160×120",
        does="a tic of the world; new episode at the end",
        share=16.0,
    ),
}
OWN = ("jaxact", "camera")
PEERS = tuple(name for name in SYSTEMS if name not in OWN)
