"""What samplers that give levels again share: a level is a seed."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.pomdp import Episode, PyTree, TaskSampler
from jaxact.train_state import make_key


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LevelOrigin:
    """Which level an episode was.

    Attributes:
      seed: uint32, of the level.
      is_new: bool, whether it was drawn as a new one rather than given again.
      inner: the origin that the level's sampler noted.
    """

    seed: jax.Array
    is_new: jax.Array
    inner: PyTree


def sample_level(
    sampler: TaskSampler, sampler_state: PyTree, key: jax.Array, known: jax.Array, is_new: jax.Array
) -> Episode:
    """Samples the episode of a known level, or of a new one; its origin is a `LevelOrigin`.

    Args:
      sampler: whose levels they are.
      sampler_state: its first state, so that a seed always stands for the same level.
      key: for the seed of a new one.
      known: uint32 scalar, the seed of the level to give again.
      is_new: bool scalar, whether to draw a new one instead.
    """
    seed = jnp.where(is_new, jax.random.bits(key, (), jnp.uint32), known)
    episode = sampler.sample(make_key(seed), sampler_state)
    origin = LevelOrigin(seed, is_new, episode.origin)
    return Episode(episode.environment, episode.task, episode.horizon, origin)


def place_of(seed: jax.Array, holds: jax.Array, wanted: jax.Array) -> jax.Array:
    """Finds levels in a buffer.

    Args:
      seed: uint32 [N], of the levels that are kept.
      holds: bool [N], where there is a level.
      wanted: uint32 [M], the seeds to find.

    Returns:
      int32 [M], the place of each, N where it is not kept.
    """
    # Equal seeds in empty places come after that of a level: sorts are stable.
    size = seed.shape[0]
    order = jnp.lexsort((~holds, seed))
    nearest = order[jnp.searchsorted(seed, wanted, sorter=order) % size]
    found = holds[nearest] & (seed[nearest] == wanted)
    return jnp.where(found, nearest, size).astype(jnp.int32)
