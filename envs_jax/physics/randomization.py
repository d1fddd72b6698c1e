"""Domain randomisation: in every episode the model has other masses, frictions and gains.

Source: Peng et al. 2018, "Sim-to-Real Transfer of Robotic Control with Dynamics Randomization"
(https://arxiv.org/abs/1710.06537).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState, Variation, check_model
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, FinishedEpisodes, PyTree, TaskSampler

Range = tuple[float, float]


@dataclass(frozen=True)
class Randomized(TaskSampler):
    """Another sampler's episodes, each with a model that differs from the one that was read.

    Every body, geom and actuator has a factor of its own, uniform in a range. How soft contacts and
    limits are stays as it was read. Held-out episodes are randomised too.

    Attributes:
      sampler: whose episodes they are.
      world: the model.
      mass: of the factors of the bodies' masses and moments of inertia.
      friction: of those of the geoms' coefficients of friction.
      gain: of those of what actuators answer to controls and to motion.

    Raises:
      JaxactError: a range is not one of positive numbers.
    """

    sampler: TaskSampler
    world: Physics
    mass: Range = (1.0, 1.0)
    friction: Range = (1.0, 1.0)
    gain: Range = (1.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("mass", "friction", "gain"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise JaxactError(
                    f"the range of {name} must be of factors 0 < low <= high, got ({low}, {high})"
                )

    @property
    def learns(self) -> bool:
        """As the sampler does."""
        return self.sampler.learns

    @property
    def held_out(self) -> TaskSampler:
        """The sampler's held-out episodes, randomised."""
        return replace(self, sampler=self.sampler.held_out)

    def init(self, key: jax.Array) -> PyTree:
        """Returns the first state of the sampler."""
        return self.sampler.init(key)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode and the model's factors."""
        model = self.world.model
        episode_key, *keys = jax.random.split(key, 4)
        episode = self.sampler.sample(episode_key, sampler_state)

        def factors(key: jax.Array, count: int, bounds: Range) -> jax.Array:
            low, high = (jnp.float32(bound) for bound in bounds)
            return low + (high - low) * jax.random.uniform(key, (count,), jnp.float32)

        variation = Variation(
            mass=factors(keys[0], model.nbody, self.mass),
            friction=factors(keys[1], model.ngeom, self.friction),
            gain=factors(keys[2], model.nu, self.gain),
        )
        begun: PhysicsState = episode.environment
        state = self.world.start(
            begun.position,
            begun.velocity,
            mocap_position=begun.mocap_position,
            mocap_rotation=begun.mocap_rotation,
            variation=variation,
        )
        return replace(episode, environment=state)

    def update(self, sampler_state: PyTree, finished: FinishedEpisodes) -> PyTree:
        """Lets the sampler learn."""
        return self.sampler.update(sampler_state, finished)

    def kinds(self, origin: PyTree) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.kinds(origin)

    def metrics(self, sampler_state: PyTree) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.metrics(sampler_state)

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment of another model."""
        check_model(pomdp, self.world, "sampler.world")
