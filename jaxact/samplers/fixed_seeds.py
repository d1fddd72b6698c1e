"""A fixed list of levels, each a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import JaxactError
from jaxact.pomdp import Episode, PyTree, TaskSampler
from jaxact.train_state import make_key

MAX_SEED = 2**32 - 1


@dataclass(frozen=True)
class FixedSeeds(TaskSampler):
    """Draws every episode from a fixed list of another sampler's levels, each as often.

    A seed stands for the episode that `sampler` draws, in its first state, with `make_key(seed)`:
    the same in every run. For tests of what can be learnt by heart, and for held-out levels that
    do not depend on the evaluation's seed.

    Attributes:
      sampler: whose levels they are; it does not learn.
      seeds: of the levels, in 0 … 2³² − 1.

    Raises:
      JaxactError: there are no seeds, or one is out of bounds.
    """

    sampler: TaskSampler
    seeds: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "seeds", tuple(self.seeds))
        if not self.seeds:
            raise JaxactError("FixedSeeds needs at least one seed")
        for seed in self.seeds:
            if not 0 <= seed <= MAX_SEED:
                raise JaxactError(f"a level's seed must be in 0 … {MAX_SEED}, got {seed}")

    def init(self, key: jax.Array) -> PyTree:
        """Returns the first state of the sampler, the same for every key."""
        del key
        return self.sampler.init(make_key(0))

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one of the levels."""
        seeds = jnp.asarray(np.asarray(self.seeds, np.uint32))
        index = jax.random.randint(key, (), 0, len(self.seeds), jnp.int32)
        return self.sampler.sample(make_key(seeds[index]), sampler_state)

    def kinds(self, origin: PyTree) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.kinds(origin)
