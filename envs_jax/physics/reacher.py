"""Gymnasium's Reacher, version 5: an arm of two links in the plane is to touch a drawn target."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState
from jaxact.pomdp import Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

TIP, TARGET = "fingertip", "target"


def _gap(world: Physics, state: PhysicsState) -> jax.Array:
    rows = [world.index("body", name) for name in (TIP, TARGET)]
    return state.body_position[rows[0]] - state.body_position[rows[1]]


@dataclass(frozen=True)
class Touch(Task):
    """Costs the distance and the effort. The episode succeeds where it ends near the target.

    Gymnasium has no rule of success, and a threshold of −3.75 for the return.

    Attributes:
      world: with the bodies "fingertip" and "target".
      near: metres.
    """

    world: Physics
    near: float = 0.02

    def step(
        self, task_state: PyTree, before: PhysicsState, action: jax.Array, after: PhysicsState
    ) -> tuple[PyTree, Outcome]:
        """Judges one step; see `Task.step`."""
        del before
        distance = jnp.linalg.norm(_gap(self.world, after))
        return task_state, Outcome(
            reward={"distance": -distance, "control": -jnp.sum(jnp.square(action))},
            success={"near": distance < jnp.float32(self.near)},
            terminated=after.diverged,
            metrics={"distance": distance, "diverged": after.diverged.astype(jnp.float32)},
        )


@dataclass(frozen=True)
class ReacherSensor(Sensor):
    """Cosines and sines of both angles, the target, their velocities and the gap, float32 [10]."""

    world: Physics

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (10,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        angles, target = state.position[:2], state.position[2:]
        gap = _gap(self.world, state)[:2]
        return jnp.concatenate([jnp.cos(angles), jnp.sin(angles), target, state.velocity[:2], gap])


@dataclass(frozen=True)
class ReacherStart(TaskSampler):
    """The arm nearly stretched out, and a target anywhere in its reach.

    Attributes:
      world: the model.
      horizon: steps.
    """

    world: Physics
    horizon: int = 50

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        arm_key, target_key, speed_key = jax.random.split(key, 3)
        arm = jax.random.uniform(arm_key, (2,), jnp.float32, -0.1, 0.1)
        share, turn = jax.random.uniform(target_key, (2,), jnp.float32)
        # Uniform in the disk.
        away, angle = 0.2 * jnp.sqrt(share), 2 * jnp.pi * turn
        target = away * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        speed = jax.random.uniform(speed_key, (2,), jnp.float32, -0.005, 0.005)
        first = jnp.asarray(self.world.model.qpos0, jnp.float32)
        position = jnp.concatenate([first[:2] + arm, target])
        state = self.world.start(position, jnp.concatenate([speed, jnp.zeros(2, jnp.float32)]))
        return Episode(state, (), jnp.int32(self.horizon))
