"""Push, and pick and place: bring an object to a target, with the rules of Meta-World.

Source: Meta-World's push-v3 and pick-place-v3 (Yu et al. 2019, https://arxiv.org/abs/1910.10897).
Its bounds of success, its horizon and where cubes and targets are drawn are here; its rewards are
not: these are terms of their own, each of which pays for what has come nearer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState, check_model
from envs_jax.physics.hand import CUBE, GRIP, HALF_CUBE, OPEN
from envs_jax.physics.reach import Reach, drawn_between
from jaxact.pomdp import POMDP, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

Point = tuple[float, float, float]
# Metres: the corners between which Meta-World draws cubes and the targets of its three tasks.
CUBES = ((-0.1, 0.6, HALF_CUBE), (0.1, 0.7, HALF_CUBE))
IN_THE_AIR = ((-0.1, 0.8, 0.05), (0.1, 0.9, 0.3))
ON_THE_TABLE = ((-0.1, 0.8, HALF_CUBE), (0.1, 0.9, HALF_CUBE))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MoveObjectState:
    """Progress of a `MoveObject`.

    Attributes:
      target: float32 [3], metres, in the world.
      distance: float32 scalar, metres from the object to it.
      gap: float32 scalar, metres from the hand's site to the object.
      rest: float32 scalar, metres: how high the object lay at first.
      lifted: bool scalar: it is in the hand, and higher than that.
    """

    target: jax.Array
    distance: jax.Array
    gap: jax.Array
    rest: jax.Array
    lifted: jax.Array


@dataclass(frozen=True)
class MoveObject(Task):
    """Bring an object to the target, in whatever way; that is success and the end.

    Attributes:
      world: which has the hand and the object.
      body: the object's name.
      site: of the hand, in the middle of its grip.
      radius: metres from the target within which the object is there.
      near: metres from the site within which the object is in the hand.
      step_penalty: the reward, a negative one, of each step.
      approach: reward for each metre that the hand comes nearer to the object.
      shaping: reward for each metre that the object comes nearer to the target.
      lift: reward when the object is lifted, taken back when it is let down.
      height: metres that are to have lifted it.
      success_reward: for the object at the target.
    """

    world: Physics
    body: str = CUBE
    site: str = GRIP
    radius: float = 0.05
    near: float = 0.03
    step_penalty: float = -0.01
    approach: float = 1.0
    shaping: float = 5.0
    lift: float = 0.0
    height: float = 0.02
    success_reward: float = 5.0

    def __post_init__(self) -> None:
        self.world.index("body", self.body)
        self.world.index("site", self.site)

    def place(self, state: PhysicsState) -> jax.Array:
        """Returns where the object is, float32 [3]."""
        return state.body_position[self.world.index("body", self.body)]

    def gap(self, state: PhysicsState) -> jax.Array:
        """Returns the way from the hand's site to the object, float32 [3]."""
        return self.place(state) - state.site_position[self.world.index("site", self.site)]

    def start(self, state: PhysicsState, target: jax.Array) -> MoveObjectState:
        """Returns the first state of an episode with a target float32 [3]."""
        return self._at(state, target, self.place(state)[2])

    def step(
        self,
        task_state: MoveObjectState,
        before: PhysicsState,
        action: jax.Array,
        after: PhysicsState,
    ) -> tuple[MoveObjectState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        old, new = task_state, self._at(after, task_state.target, task_state.rest)
        placed = new.distance <= jnp.float32(self.radius)
        raised = new.lifted.astype(jnp.float32) - old.lifted.astype(jnp.float32)
        return new, Outcome(
            reward={
                "step": jnp.float32(self.step_penalty),
                "approach": jnp.float32(self.approach) * (old.gap - new.gap),
                "shaping": jnp.float32(self.shaping) * (old.distance - new.distance),
                "lift": jnp.float32(self.lift) * raised,
                "success": jnp.where(placed, jnp.float32(self.success_reward), 0),
            },
            success={"placed": placed},
            terminated=placed | after.diverged,
            metrics={
                "distance": new.distance,
                "gap": new.gap,
                "lifted": new.lifted.astype(jnp.float32),
                "diverged": after.diverged.astype(jnp.float32),
            },
        )

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment of another model, in which the object would be another."""
        check_model(pomdp, self.world, "task.world")

    def _at(self, state: PhysicsState, target: jax.Array, rest: jax.Array) -> MoveObjectState:
        place, gap = self.place(state), jnp.linalg.norm(self.gap(state))
        raised = place[2] - rest > jnp.float32(self.height)
        distance = jnp.linalg.norm(target - place)
        return MoveObjectState(target, distance, gap, rest, raised & (gap < jnp.float32(self.near)))


@dataclass(frozen=True)
class OnTable(TaskSampler):
    """The open hand where it begins, the cube on the table, and a target some way from it.

    Attributes:
      world: of the hand.
      task: that begins, of the cube's or of the hand's own way.
      cubes: two corners, metres, between which the cube is drawn.
      targets: likewise of targets.
      apart: metres in the plane that there are at least from the cube to the target, if any of the
        targets drawn is so far.
      candidates: targets drawn.
      horizon: steps.
    """

    world: Physics
    task: Reach | MoveObject
    cubes: tuple[Point, Point] = CUBES
    targets: tuple[Point, Point] = IN_THE_AIR
    apart: float = 0.15
    candidates: int = 8
    horizon: int = 500

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        model = self.world.model
        cube_key, target_key = jax.random.split(key)
        cube = drawn_between(cube_key, *self.cubes, 1)[0]
        targets = drawn_between(target_key, *self.targets, self.candidates)
        away = jnp.linalg.norm(targets[:, :2] - cube[:2], axis=-1)
        # The first that is far enough, or the farthest.
        target = targets[jnp.argmax(jnp.minimum(away, jnp.float32(self.apart)))]
        first = int(model.joint(CUBE).qposadr[0])
        position = jnp.asarray(model.qpos0, jnp.float32).at[first : first + 3].set(cube)
        for finger in ("left finger", "right finger"):
            position = position.at[int(model.joint(finger).qposadr[0])].set(OPEN)
        state = self.world.start(position, jnp.zeros(model.nv, jnp.float32))
        return Episode(state, self.task.start(state, target), jnp.int32(self.horizon))


@dataclass(frozen=True)
class GapSensor(Sensor):
    """The way from the hand's grip to the object, metres, float32 [3].

    Attributes:
      task: whose object it is.
    """

    task: MoveObject

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (3,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        return self.task.gap(state)
