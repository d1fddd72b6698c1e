"""Many different tasks in one batch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError, unknown
from jaxact.frozen import FrozenMapping
from jaxact.pomdp import Episode, FinishedEpisodes, PyTree, TaskSampler
from jaxact.samplers.parts import (
    PartOrigin,
    draw_part,
    init_parts,
    kinds_of_parts,
    metrics_of_parts,
    update_parts,
)


@dataclass(frozen=True)
class MixtureSampler(TaskSampler):
    """Draws each episode from one of several named samplers, chosen at random.

    Success is reported for each by its name: when training under "train/kinds/{name}/success", in
    evaluation under "kinds/{name}/success". The parts share the POMDP's environment, task and
    sensors, so their episodes must be of one structure, with the same shapes and dtypes. Parts may
    learn; each is told of its own episodes.

    A batch of episodes costs little more than if each had been drawn from its own part alone; see
    `parts.draw_part`. Each part is compiled in, once.

    Attributes:
      parts: samplers by name.
      weights: how often each is drawn from, in proportion; 1 for those without.

    Raises:
      JaxactError: a weight of no part, a negative one, or none that is positive.
    """

    parts: Mapping[str, TaskSampler]
    weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("parts", "weights"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))
        for name, weight in self.weights.items():
            if name not in self.parts:
                raise unknown("part of the mixture", name, self.parts)
            if weight < 0:
                raise JaxactError(f"the weight of {name!r} must not be negative, got {weight}")
        if not any(self.weights.get(name, 1.0) > 0 for name in self.parts):
            raise JaxactError("a mixture needs at least one part whose weight is positive")

    @property
    def learns(self) -> bool:
        """Whether any part learns."""
        return any(part.learns for part in self.parts.values())

    @property
    def held_out(self) -> TaskSampler:
        """The mixture of what its parts are to be evaluated on."""
        parts = {name: part.held_out for name, part in self.parts.items()}
        return MixtureSampler(parts, self.weights)

    def init(self, key: jax.Array) -> tuple[PyTree, ...]:
        """Returns the first state of each part.

        Raises:
          JaxactError: the parts' episodes differ in structure, shapes or dtypes.
        """
        return init_parts(self.parts, key)

    def sample(self, key: jax.Array, sampler_state: tuple[PyTree, ...]) -> Episode:
        """Draws one episode."""
        part_key, draw_key = jax.random.split(key)
        weights = [jnp.asarray(self.weights.get(name, 1.0), jnp.float32) for name in self.parts]
        bounds = jnp.cumsum(jnp.stack(weights))
        uniform = jax.random.uniform(part_key, (), jnp.float32)
        part = jnp.sum(uniform * bounds[-1] >= bounds[:-1], dtype=jnp.int32)
        return draw_part(tuple(self.parts.values()), part, draw_key, sampler_state)

    def update(
        self, sampler_state: tuple[PyTree, ...], finished: FinishedEpisodes
    ) -> tuple[PyTree, ...]:
        """Tells each part how its own episodes ended."""
        return update_parts(tuple(self.parts.values()), sampler_state, finished)

    def kinds(self, origin: PartOrigin) -> dict[str, jax.Array]:
        """One for each part, by its name."""
        return kinds_of_parts(self.parts, origin)

    def metrics(self, sampler_state: tuple[PyTree, ...]) -> dict[str, jax.Array]:
        """Those of the parts, under "part/metric"."""
        return metrics_of_parts(self.parts, sampler_state)
