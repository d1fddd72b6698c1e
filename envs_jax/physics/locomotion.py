"""Tasks of Gymnasium's MuJoCo environments, version 5: their rewards, ends and starts.

Source: `gymnasium.envs.mujoco` 1.x. The state of each task is the return so far, float32, and an
episode succeeds once that is what Gymnasium asks for (`reward_threshold`), where it asks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState, check_model
from jaxact.errors import JaxactError, check_at_least
from jaxact.pomdp import POMDP, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

Bounds = tuple[float, float]
_ANY: Bounds = (-math.inf, math.inf)


def _judged(
    so_far: jax.Array,
    reward: dict[str, jax.Array],
    threshold: float,
    fails: jax.Array,
    after: PhysicsState,
    **metrics: jax.Array,
) -> tuple[jax.Array, Outcome]:
    """Adds up a step's reward; a simulation that has come apart ends the episode."""
    reward = {name: jnp.asarray(x, jnp.float32) for name, x in reward.items()}
    so_far = so_far + jnp.sum(jnp.stack(list(reward.values())))
    return so_far, Outcome(
        reward=reward,
        success={"return": so_far >= jnp.float32(threshold)},
        terminated=fails | after.diverged,
        metrics={"diverged": after.diverged.astype(jnp.float32), **metrics},
    )


def _within(x: jax.Array, bounds: Bounds) -> jax.Array:
    return jnp.all((x > jnp.float32(bounds[0])) & (x < jnp.float32(bounds[1])))


def _square(x: jax.Array) -> jax.Array:
    return jnp.sum(jnp.square(x))


@dataclass(frozen=True)
class RunForward(Task):
    """Get on along x: Swimmer, HalfCheetah, Hopper and Walker2d.

    Attributes:
      world: how long a step takes, is asked there.
      threshold: the return to succeed with.
      forward: reward of a metre a second.
      control: cost of a unit of the actions' squares.
      healthy: reward of a step after which the body is well.
      height: bounds of the second joint beyond which it is not.
      angle: those of the third joint.
      others: those of all joints' positions and velocities from the third on, besides.
    """

    world: Physics
    threshold: float
    forward: float = 1.0
    control: float = 1e-3
    healthy: float = 0.0
    height: Bounds = _ANY
    angle: Bounds = _ANY
    others: Bounds = _ANY

    def step(
        self, task_state: jax.Array, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        speed = (after.position[0] - before.position[0]) / jnp.float32(self.world.dt)
        is_well = _within(after.position[1], self.height) & _within(after.position[2], self.angle)
        moving = jnp.concatenate([after.position[2:], after.velocity])
        is_well &= _within(moving, self.others)
        reward = {
            "forward": jnp.float32(self.forward) * speed,
            "control": -jnp.float32(self.control) * _square(action),
            "healthy": jnp.where(is_well, jnp.float32(self.healthy), 0.0),
        }
        return _judged(
            task_state, reward, self.threshold, ~is_well, after, x=after.position[0], speed=speed
        )


@dataclass(frozen=True)
class RunUpright(Task):
    """Get on along x without falling over: Ant and Humanoid. The first body is the torso.

    Attributes:
      world: with the extra "cfrc_ext"; how long a step takes, is asked there.
      threshold: the return to succeed with.
      height: bounds of the torso's height beyond which the body is not well.
      forward: reward of a metre a second.
      control: cost of a unit of the actions' squares.
      contact: cost of a unit of the squares of forces from outside.
      force_bound: beyond which no number of a force counts.
      cost_bound: what contacts cost at most in a step.
      healthy: reward of a step after which the body is well.
      whole: whether the speed is that of the whole body's centre of mass (the extra "subtree_com"),
        and not the torso's.
    """

    world: Physics
    threshold: float
    height: Bounds
    forward: float = 1.0
    control: float = 0.5
    contact: float = 5e-4
    force_bound: float = math.inf
    cost_bound: float = math.inf
    healthy: float = 1.0
    whole: bool = False

    def __post_init__(self) -> None:
        for name in ("cfrc_ext", *(("subtree_com",) if self.whole else ())):
            if name not in self.world.extras:
                raise JaxactError(
                    f"{type(self).__name__} reads {name!r}, which its world does not keep: "
                    f"Physics(..., extras=({name!r},))"
                )

    def step(
        self, task_state: jax.Array, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        speed = (self._place(after) - self._place(before)) / jnp.float32(self.world.dt)
        is_well = _within(after.position[2], self.height) & ~after.diverged
        forces = jnp.clip(after.extras["cfrc_ext"], -self.force_bound, self.force_bound)
        costs = jnp.minimum(jnp.float32(self.contact) * _square(forces), self.cost_bound)
        reward = {
            "forward": jnp.float32(self.forward) * speed,
            "control": -jnp.float32(self.control) * _square(action),
            "contact": -costs,
            "healthy": jnp.where(is_well, jnp.float32(self.healthy), 0.0),
        }
        return _judged(
            task_state, reward, self.threshold, ~is_well, after, x=after.position[0], speed=speed
        )

    def _place(self, state: PhysicsState) -> jax.Array:
        return state.extras["subtree_com"][0, 0] if self.whole else state.body_position[1, 0]

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment of another model, or one that does not keep what is read."""
        check_model(pomdp, self.world, "task.world")


@dataclass(frozen=True)
class WholeBodySensor(Sensor):
    """What Ant's and Humanoid's agents see: joints but for x and y, velocities, and more.

    After them come, of those that the world keeps, "cinert", "cvel", "qfrc_actuator" but for the
    root's six numbers, and "cfrc_ext"; of bodies those of all but the world's.

    Attributes:
      world: of the body.
      force_bound: to which forces from outside are clipped.
    """

    world: Physics
    force_bound: float = math.inf

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        model = self.world.model
        bodies = model.nbody - 1
        counts = {"cinert": 10 * bodies, "cvel": 6 * bodies, "cfrc_ext": 6 * bodies}
        counts["qfrc_actuator"] = model.nv - 6
        count = model.nq - 2 + model.nv + sum(counts.get(name, 0) for name in self.world.extras)
        return Box(-math.inf, math.inf, (count,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        extras = state.extras
        parts = [state.position[2:], state.velocity]
        parts += [extras[name][1:].ravel() for name in ("cinert", "cvel") if name in extras]
        if "qfrc_actuator" in extras:
            parts.append(extras["qfrc_actuator"][6:])
        if "cfrc_ext" in extras:
            forces = extras["cfrc_ext"][1:].ravel()
            parts.append(jnp.clip(forces, -self.force_bound, self.force_bound))
        return jnp.concatenate(parts)


@dataclass(frozen=True)
class Balance(Task):
    """InvertedPendulum: 1 for every step after which the pole leans less than `lean` radians."""

    threshold: float = 950.0
    lean: float = 0.2

    def step(
        self, task_state: jax.Array, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        falls = (jnp.abs(after.position[1]) > jnp.float32(self.lean)) | after.diverged
        return _judged(task_state, {"healthy": ~falls}, self.threshold, falls, after)


@dataclass(frozen=True)
class BalanceTwo(Task):
    """InvertedDoublePendulum: keep the tip, the model's first site, up and still.

    Attributes:
      threshold: the return to succeed with.
      healthy: reward of a step after which the tip is more than 1 m up.
    """

    threshold: float = 9100.0
    healthy: float = 10.0

    def step(
        self, task_state: jax.Array, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        x, _, height = after.site_position[0]
        falls = (height <= 1) | after.diverged
        costs = jnp.array([1e-3, 5e-3], jnp.float32)
        reward = {
            "healthy": jnp.where(falls, 0.0, jnp.float32(self.healthy)),
            "distance": -(jnp.float32(0.01) * x**2 + (height - 2) ** 2),
            "velocity": -jnp.sum(costs * after.velocity[1:3] ** 2),
        }
        return _judged(task_state, reward, self.threshold, falls, after)


@dataclass(frozen=True)
class BalanceSensor(Sensor):
    """What InvertedDoublePendulum's agent sees, float32 [9].

    The cart's place, sines and cosines of both angles, velocities, and the force that holds the
    cart on its rail; the last four within ± 10.
    """

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (9,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        angles = state.position[1:]
        clipped = jnp.clip(jnp.concatenate([state.velocity, state.constraint_force[:1]]), -10, 10)
        return jnp.concatenate([state.position[:1], jnp.sin(angles), jnp.cos(angles), clipped])


@dataclass(frozen=True)
class NoisyStart(TaskSampler):
    """Joints near where the model has them.

    Attributes:
      world: the model.
      position: joints are moved by up to this, uniformly.
      velocity: and so are their velocities,
      normal: or are these normal with this deviation?
      horizon: steps.
    """

    world: Physics
    position: float
    velocity: float
    normal: bool = False
    horizon: int = 1000

    def __post_init__(self) -> None:
        check_at_least(1, "a noisy start's episodes", horizon=self.horizon)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        model = self.world.model
        place_key, speed_key = jax.random.split(key)
        moved = jax.random.uniform(place_key, (model.nq,), jnp.float32, -1.0, 1.0)
        position = jnp.asarray(model.qpos0, jnp.float32) + jnp.float32(self.position) * moved
        if self.normal:
            speed = jax.random.normal(speed_key, (model.nv,), jnp.float32)
        else:
            speed = jax.random.uniform(speed_key, (model.nv,), jnp.float32, -1.0, 1.0)
        state = self.world.start(position, jnp.float32(self.velocity) * speed)
        return Episode(state, jnp.float32(0.0), jnp.int32(self.horizon))
