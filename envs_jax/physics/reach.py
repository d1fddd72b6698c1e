"""Reach: bring a site of any robot to a drawn target. And an arm of three joints to do it with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState, check_model
from jaxact.pomdp import POMDP, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

TIP = "tip"
# It has no floor beneath it and passes through itself: nothing of it collides.
ARM = """
<mujoco model="arm">
  <option timestep="0.01" iterations="4" ls_iterations="8"/>
  <default>
    <geom type="capsule" contype="0" conaffinity="0" size="0.03"/>
    <joint damping="0.5" armature="0.02"/>
  </default>
  <worldbody>
    <body name="turret" pos="0 0 0.1">
      <joint name="turn" axis="0 0 1"/>
      <geom fromto="0 0 0 0 0 0.2" mass="1"/>
      <body name="upper arm" pos="0 0 0.2">
        <joint name="shoulder" axis="0 1 0" range="-100 100"/>
        <geom fromto="0 0 0 0 0 0.3" mass="0.6"/>
        <body name="forearm" pos="0 0 0.3">
          <joint name="elbow" axis="0 1 0" range="-140 140"/>
          <geom fromto="0 0 0 0 0 0.25" mass="0.4"/>
          <site name="tip" pos="0 0 0.25"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" gear="3" ctrlrange="-1 1"/>
    <motor joint="shoulder" gear="8" ctrlrange="-1 1"/>
    <motor joint="elbow" gear="3" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def arm() -> Physics:
    """Returns the arm's world: torques are chosen 25 times a second."""
    return Physics(ARM, substeps=4)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ReachState:
    """Progress of a `Reach`.

    Attributes:
      target: float32 [3], metres, in the world.
      distance: float32 scalar, metres from it.
    """

    target: jax.Array
    distance: jax.Array


@dataclass(frozen=True)
class Reach(Task):
    """Bring a site to the target; that is success and the end.

    Attributes:
      world: which has the site.
      site: its name.
      radius: metres from the target within which it is reached.
      step_penalty: the reward, a negative one, of each step.
      shaping: reward for each metre that the site comes nearer.
      effort: cost of a unit of the actions' squares.
      success_reward: for reaching it.
    """

    world: Physics
    site: str = TIP
    radius: float = 0.05
    step_penalty: float = -0.01
    shaping: float = 1.0
    effort: float = 1e-3
    success_reward: float = 1.0

    def __post_init__(self) -> None:
        self.world.index("site", self.site)

    def place(self, state: PhysicsState) -> jax.Array:
        """Returns where the site is, float32 [3]."""
        return state.site_position[self.world.index("site", self.site)]

    def start(self, state: PhysicsState, target: jax.Array) -> ReachState:
        """Returns the first state of an episode with a target float32 [3]."""
        return ReachState(target, jnp.linalg.norm(target - self.place(state)))

    def step(
        self, task_state: ReachState, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[ReachState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before
        new = self.start(after, task_state.target)
        reached = new.distance < jnp.float32(self.radius)
        spent = jnp.sum(jnp.square(jnp.asarray(action, jnp.float32)))
        return new, Outcome(
            reward={
                "step": jnp.float32(self.step_penalty),
                "shaping": jnp.float32(self.shaping) * (task_state.distance - new.distance),
                "effort": -jnp.float32(self.effort) * spent,
                "success": jnp.where(reached, jnp.float32(self.success_reward), 0),
            },
            success={"reached": reached},
            terminated=reached | after.diverged,
            metrics={
                "distance": new.distance,
                "diverged": after.diverged.astype(jnp.float32),
            },
        )

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment of another model, in which the site would be another."""
        check_model(pomdp, self.world, "task.world")


@dataclass(frozen=True)
class AnyPose(TaskSampler):
    """A robot in any pose, and a target where its site is in another.

    Joints with a range are drawn within it, others within ± π: radians, or metres of a slide.

    Attributes:
      world: of a robot whose joints are hinges and slides.
      task: that begins.
      horizon: steps.
    """

    world: Physics
    task: Reach
    horizon: int = 100

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        model = self.world.model
        lows, highs = jnp.asarray(model.jnt_range.T, jnp.float32)
        limited = jnp.asarray(model.jnt_limited.astype(bool))
        lows, highs = jnp.where(limited, lows, -math.pi), jnp.where(limited, highs, math.pi)
        share = jax.random.uniform(key, (2, model.nq), jnp.float32)
        pose, aim = lows + share * (highs - lows)
        rest = jnp.zeros(model.nv, jnp.float32)
        state = self.world.start(pose, rest)
        target = self.task.place(self.world.start(aim, rest))
        return Episode(state, self.task.start(state, target), jnp.int32(self.horizon))


class Aim(Protocol):
    """The state of a task with a target, float32 [3]."""

    @property
    def target(self) -> jax.Array:
        """Metres, in the world."""


class Aimed(Protocol):
    """A task with something to be brought to its target."""

    def place(self, state: PhysicsState) -> jax.Array:
        """Returns where that is, float32 [3]."""


@dataclass(frozen=True)
class TargetSensor(Sensor):
    """Where the target is from the world's origin, and from what is to be there.

    It is float32 [6], metres.

    Attributes:
      task: a `Reach` with its site, or any other that is `Aimed`.
    """

    task: Aimed

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (6,))

    def observe(self, state: PhysicsState, task_state: Aim) -> jax.Array:
        """Returns the reading."""
        gap = task_state.target - self.task.place(state)
        return jnp.concatenate([task_state.target, gap])


def drawn_between(
    key: jax.Array, low: tuple[float, ...], high: tuple[float, ...], count: int
) -> jax.Array:
    """Draws points float32 [count, D], uniform between two corners of D numbers."""
    lows, highs = jnp.array(low, jnp.float32), jnp.array(high, jnp.float32)
    return lows + (highs - lows) * jax.random.uniform(key, (count, len(low)), jnp.float32)
