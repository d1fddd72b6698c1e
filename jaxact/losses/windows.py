"""What losses on windows of time need: which steps are of one episode, where episodes end, draws.

A window [T, B] is whatever a batch holds of each lane; the episodes at its edges are cut there.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxact.errors import unknown
from jaxact.losses.base import Batch
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree


def named_features(output: ActorCriticOutput, name: str) -> jax.Array:
    """Returns the features of that name in the model's extras, float32 [..., F].

    Raises:
      JaxactError: the model has none of that name.
    """
    if name not in output.extras:
        raise unknown("feature of the model, in a loss", name, output.extras)
    features: jax.Array = output.extras[name]
    return features


def later(tree: PyTree, steps: int) -> PyTree:
    """Returns what is `steps` later at each step, [T, B, ...]; the last steps see the first ones,
    and are to be left out by `goes_on`.
    """
    return jax.tree.map(lambda x: jnp.roll(x, -steps, axis=0), tree)


def goes_on(is_first: jax.Array, steps: int) -> jax.Array:
    """Returns whether the step that is `steps` later is in the window and of the same episode.

    Args:
      is_first: bool [T, B].
      steps: at least 1.
    """
    episode = jnp.cumsum(is_first, axis=0, dtype=jnp.int32)
    inside = jnp.arange(is_first.shape[0], dtype=jnp.int32)[:, None] < is_first.shape[0] - steps
    return inside & (later(episode, steps) == episode)


def first_and_last(is_first: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns where each step's episode begins and ends in the window.

    Args:
      is_first: bool [T, B].

    Returns:
      Indices int32 [T, B].
    """
    time = jnp.broadcast_to(jnp.arange(is_first.shape[0], dtype=jnp.int32)[:, None], is_first.shape)
    first = jax.lax.cummax(jnp.where(is_first, time, 0), axis=0)
    ends = jnp.where(goes_on(is_first, 1), jnp.int32(is_first.shape[0]), time)
    return first, jax.lax.cummin(ends, axis=0, reverse=True)


def at_last(features: jax.Array, is_first: jax.Array) -> jax.Array:
    """Returns at each step the features [T, B, F] of its episode's last step in the window."""
    _, last = first_and_last(is_first)
    return jnp.take_along_axis(features, last[..., None], axis=0)


def uniform(batch: Batch, *shape: int) -> jax.Array:
    """Draws numbers in [0, 1) from the lanes' keys, the same on any number of devices.

    Args:
      batch: whose lanes.
      shape: of each step's draws.

    Returns:
      float32 [T, B, *shape].
    """
    length = batch.is_first.shape[0]

    def draw(key: jax.Array) -> jax.Array:
        # The key itself has already decided in which minibatch its lane is.
        return jax.random.uniform(jax.random.fold_in(key, 1), (length, *shape), jnp.float32)

    return jax.vmap(draw, out_axes=1)(batch.key)
