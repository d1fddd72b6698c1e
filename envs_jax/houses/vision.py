"""What an agent's camera shows: colours, depths, categories and instances, and a map around it.

Sensors with the same camera share its rays: jitted, what several of them compute alike is computed
once.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories, pictures
from envs_jax.houses.camera import Camera, eye
from envs_jax.houses.object_nav import ObjectNavState
from envs_jax.houses.paint import photograph
from envs_jax.houses.rays import View, look
from envs_jax.houses.scene import CENTER, HALF_SIZE, forward, to_local
from envs_jax.houses.sensor_noise import DisparityNoise, GaussianNoise, noise_key
from envs_jax.houses.state import Body, HouseState
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, PyTree, Sensor
from jaxact.spaces import Box

# Streams of noise.
_RGB, _DEPTH = 0, 1
# Metres above the floor that are no obstacle.
_STEP_OVER = np.float32(0.02)


@dataclass(frozen=True)
class DepthScale:
    """How depths become readings: clipped to [low, high], less `mean`, divided by `deviation`.

    Attributes:
      low: metres.
      high: metres; what is farther, or nothing at all, reads the same.
      mean: metres.
      deviation: metres.
    """

    numbers_are_structure: ClassVar[bool] = True

    low: float
    high: float
    mean: float = 0.0
    deviation: float = 1.0

    def apply(self, depth: jax.Array) -> jax.Array:
        """Returns the readings of depths in metres."""
        return (jnp.clip(depth, self.low, self.high) - self.mean) / self.deviation

    def space(self, height: int, width: int) -> Box:
        """Returns the space of a picture of readings."""
        low, high = ((x - self.mean) / self.deviation for x in (self.low, self.high))
        return Box(low, high, (height, width, 1))


METRES = DepthScale(0.0, 100.0)
ALLENACT_DEPTH = DepthScale(0.0, 5.0, 0.5, 0.25)
HABITAT_DEPTH = DepthScale(0.0, 10.0, 0.0, 10.0)


@dataclass(frozen=True)
class CameraSensor(Sensor):
    """What sensors with a camera share.

    Attributes:
      camera: the camera.
      body: what carries it.
    """

    numbers_are_structure: ClassVar[bool] = True

    camera: Camera
    body: Body

    def check(self, pomdp: POMDP) -> None:
        """Refuses a body that is not the environment's."""
        body = getattr(pomdp.environment, "body", self.body)
        if body != self.body:
            raise JaxactError(
                f"a camera's body is {self.body!r}, but environment.body is {body!r}: "
                "both are set alike"
            )

    def look(self, state: HouseState) -> View:
        """Returns what the camera sees."""
        return look(self.camera, eye(state, self.body), state.scene)

    def picture(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the reading in colours, enlarged, uint8 [H, W, 3]."""
        return pictures.enlarge(self._colored(state, task_state))

    @abstractmethod
    def _colored(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the reading in colours, uint8 [H, W, 3]."""


@dataclass(frozen=True)
class RGBSensor(CameraSensor):
    """Colours, uint8 [H, W, 3]; what they show is in `paint`.

    Attributes:
      rays: edge of the square of rays that are averaged in a pixel; 2 makes thin things and edges
        smooth, at four times the cost.
      noise: None for none.
    """

    rays: int = 1
    noise: GaussianNoise | None = None

    def __post_init__(self) -> None:
        if self.rays < 1:
            raise JaxactError(f"rays must be at least 1; got {self.rays!r}")

    @property
    def space(self) -> Box:
        """RGB."""
        return Box(0, 255, (self.camera.height, self.camera.width, 3), "uint8")

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the picture."""
        del task_state
        picture = photograph(self.camera, eye(state, self.body), state.scene, self.rays)
        if self.noise is None:
            return picture
        return self.noise.apply(noise_key(state, _RGB), picture)

    def _colored(self, state: HouseState, task_state: PyTree) -> jax.Array:
        return self.observe(state, task_state)


@dataclass(frozen=True)
class DepthSensor(CameraSensor):
    """Depths, float32 [H, W, 1].

    Attributes:
      scale: `METRES`, `ALLENACT_DEPTH`, `HABITAT_DEPTH` or another.
      ranges: whether to measure along the rays instead of along the camera's axis.
      noise: of the depths, before they are scaled; None for none.
    """

    scale: DepthScale = METRES
    ranges: bool = False
    noise: DisparityNoise | None = None

    @property
    def space(self) -> Box:
        """Scaled depths."""
        return self.scale.space(self.camera.height, self.camera.width)

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the depths."""
        del task_state
        return self.scale.apply(self._metres(state))[..., None]

    def _metres(self, state: HouseState) -> jax.Array:
        depth = self.look(state).depth
        if self.noise is not None:
            depth = self.noise.apply(noise_key(state, _DEPTH), depth)
        if self.ranges:
            depth = depth * self.camera.rays(state.pitch).lengths
        return depth

    def _colored(self, state: HouseState, task_state: PyTree) -> jax.Array:
        return pictures.color_depth(self._metres(state))


@dataclass(frozen=True)
class SemanticSensor(CameraSensor):
    """What is seen, uint8 [H, W], as indices into `categories.NAMES`."""

    @property
    def space(self) -> Box:
        """Categories."""
        last = len(categories.NAMES) - 1
        return Box(0, last, (self.camera.height, self.camera.width), "uint8")

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the categories."""
        del task_state
        # Nothing, floor and ceiling have the same numbers as surfaces and as categories.
        planes = jnp.arange(3, dtype=jnp.uint8)
        table = jnp.concatenate([planes, state.scene.category.astype(jnp.uint8)])
        return table[self.look(state).surface]

    def _colored(self, state: HouseState, task_state: PyTree) -> jax.Array:
        return pictures.color_numbers(self.observe(state, task_state))


@dataclass(frozen=True)
class GoalMaskSensor(CameraSensor):
    """Where what ObjectNav is to find is seen, float32 [H, W, 1]: 1 at its pixels, else 0.

    What a perfect detector of objects tells, in the manner of ManipulaTHOR's and of HomeRobot's
    goal masks: what is left to learn is where to look and how to get there.
    """

    @property
    def space(self) -> Box:
        """Not the goal, or the goal."""
        return Box(0.0, 1.0, (self.camera.height, self.camera.width, 1))

    def observe(self, state: HouseState, task_state: ObjectNavState) -> jax.Array:
        """Returns the mask."""
        return self._mask(state, task_state)[..., None].astype(jnp.float32)

    def _mask(self, state: HouseState, task_state: ObjectNavState) -> jax.Array:
        # Nothing, floor and ceiling are never sought.
        planes = jnp.zeros(3, bool)
        is_goal = jnp.concatenate([planes, state.scene.category == task_state.category])
        return is_goal[self.look(state).surface]

    def _colored(self, state: HouseState, task_state: ObjectNavState) -> jax.Array:
        return pictures.color_numbers(self._mask(state, task_state).astype(jnp.uint8))


@dataclass(frozen=True)
class InstanceSensor(CameraSensor):
    """Which thing is seen, uint16 [H, W].

    0 nothing, 1 the floor, 2 the ceiling, and 3 + i the box in row i of the scene.
    """

    @property
    def space(self) -> Box:
        """Numbers of surfaces."""
        return Box(0, 1023, (self.camera.height, self.camera.width), "uint16")

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the numbers."""
        del task_state
        return self.look(state).surface.astype(jnp.uint16)

    def _colored(self, state: HouseState, task_state: PyTree) -> jax.Array:
        return pictures.color_numbers(self.observe(state, task_state))


@dataclass(frozen=True)
class MapSensor(Sensor):
    """What stands around the agent, in sight or not: uint8 [cells, cells, 1], 1 where something is.

    The agent is in the middle and looks along the first axis towards 0; the second axis goes from
    left to right. A cell is taken if any part of it may be: nothing is too thin to show.

    Attributes:
      cells: edge of the map.
      size: metres of a cell's edge.
      body: of the agent: what begins above its height is not in its way.
    """

    numbers_are_structure: ClassVar[bool] = True

    cells: int
    size: float
    body: Body

    def __post_init__(self) -> None:
        if self.cells < 1 or not self.size > 0:
            raise JaxactError(
                f"a map needs cells of some size; got {self.cells} of {self.size!r} metres"
            )

    @property
    def space(self) -> Box:
        """Free or taken."""
        return Box(0, 1, (self.cells, self.cells, 1), "uint8")

    def observe(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the map."""
        del task_state
        steps = self.size * (np.arange(self.cells) - (self.cells - 1) / 2)
        aside = jnp.asarray(steps, jnp.float32)[:, None]
        ahead = -aside[:, None]
        front = forward(state.yaw)
        right = jnp.stack([front[1], -front[0]])
        plan = state.position + ahead * front + aside * right
        boxes = state.scene.boxes
        middle, half = boxes[:, CENTER][:, 1], boxes[:, HALF_SIZE][:, 1]
        in_the_way = (middle - half < self.body.height) & (middle + half > _STEP_OVER)
        reach = boxes[:, HALF_SIZE][:, ::2] + jnp.float32(self.size / 2)
        within = jnp.all(jnp.abs(to_local(boxes, plan)) <= reach, axis=-1)
        return jnp.any(within & in_the_way, axis=-1)[..., None].astype(jnp.uint8)

    def picture(self, state: HouseState, task_state: PyTree) -> jax.Array:
        """Returns the map, light where something is, uint8 [256, 256, 3]."""
        shades = jnp.broadcast_to(
            255 * self.observe(state, task_state), (self.cells, self.cells, 3)
        )
        return pictures.enlarge(shades.astype(jnp.uint8))
