"""Action distributions: registered pytrees, so that they can be vmapped, stacked and scanned.

Leading axes are batch axes; the event axes are those of one action.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError


class Distribution(ABC):
    """A batch of distributions over actions."""

    @abstractmethod
    def sample(self, key: jax.Array) -> Any:
        """Draws one action for each batch entry."""

    @abstractmethod
    def mode(self) -> Any:
        """Returns the most likely action."""

    @abstractmethod
    def log_prob(self, action: Any) -> jax.Array:
        """Returns the log-probability (density) of `action`, float32 [batch]."""

    @abstractmethod
    def entropy(self) -> jax.Array:
        """Returns the entropy in nats, float32 [batch]."""

    def kl(self, other: Any) -> jax.Array:
        """Returns KL(self ‖ other) in nats, float32 [batch]; `other` is of the same kind.

        Raises:
          JaxactError: it is not known in closed form.
        """
        raise JaxactError(f"the KL divergence of {type(self).__name__} has no closed form here")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Categorical(Distribution):
    """Over 0 … n − 1.

    Attributes:
      logits: float32 [batch, n], not necessarily normalised.
    """

    logits: jax.Array

    def sample(self, key: jax.Array) -> jax.Array:
        """Draws int32 [batch] by inverting the cumulative sum: one uniform number an action."""
        cumulative = jnp.cumsum(jax.nn.softmax(self.logits), axis=-1)
        uniform = jax.random.uniform(key, (*self.logits.shape[:-1], 1), jnp.float32)
        # Scaling by the last sum keeps the draw inside the support whatever the rounding.
        below = cumulative <= uniform * cumulative[..., -1:]
        return jnp.minimum(
            jnp.sum(below, axis=-1, dtype=jnp.int32), jnp.int32(self.logits.shape[-1] - 1)
        )

    def mode(self) -> jax.Array:  # noqa: D102
        return jnp.argmax(self.logits, axis=-1).astype(jnp.int32)

    def log_prob(self, action: jax.Array) -> jax.Array:  # noqa: D102
        # A one-hot product rather than a gather: its gradient is no scatter.
        chosen = jax.nn.one_hot(action, self.logits.shape[-1], dtype=self.logits.dtype)
        return jnp.sum(jax.nn.log_softmax(self.logits) * chosen, axis=-1)

    def entropy(self) -> jax.Array:  # noqa: D102
        log_probs = jax.nn.log_softmax(self.logits)
        return -jnp.sum(jnp.exp(log_probs) * log_probs, axis=-1)

    def kl(self, other: Categorical) -> jax.Array:  # noqa: D102
        log_ratio = jax.nn.log_softmax(self.logits) - jax.nn.log_softmax(other.logits)
        return jnp.sum(self.probabilities * log_ratio, axis=-1)

    @property
    def probabilities(self) -> jax.Array:
        """float32 [batch, n]."""
        return jax.nn.softmax(self.logits)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DiagonalNormal(Distribution):
    """Independent normals; the last axis is the event.

    Attributes:
      mean: float32 [batch, d].
      log_std: float32, broadcastable to `mean`.
    """

    mean: jax.Array
    log_std: jax.Array

    def sample(self, key: jax.Array) -> jax.Array:  # noqa: D102
        noise = jax.random.normal(key, self.mean.shape, self.mean.dtype)
        return self.mean + jnp.exp(self.log_std) * noise

    def mode(self) -> jax.Array:  # noqa: D102
        return self.mean

    def log_prob(self, action: jax.Array) -> jax.Array:  # noqa: D102
        z = (action - self.mean) * jnp.exp(-self.log_std)
        return -jnp.sum(0.5 * z * z + self.log_std + 0.5 * jnp.log(2 * jnp.pi), axis=-1)

    def entropy(self) -> jax.Array:  # noqa: D102
        log_std = jnp.broadcast_to(self.log_std, self.mean.shape)
        return jnp.sum(log_std + 0.5 * jnp.log(2 * jnp.pi * jnp.e), axis=-1)

    def kl(self, other: DiagonalNormal) -> jax.Array:  # noqa: D102
        log_ratio = self.log_std - other.log_std
        z = (self.mean - other.mean) * jnp.exp(-other.log_std)
        return jnp.sum(0.5 * (jnp.exp(2 * log_ratio) + z * z - 1.0) - log_ratio, axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Joint(Distribution):
    """Independent parts, for tuple and dict action spaces.

    Attributes:
      parts: tuple or dict of distributions, shaped like the action.
    """

    parts: Any

    def _leaves(self) -> tuple[list[Distribution], Any]:
        return jax.tree.flatten(self.parts, is_leaf=lambda x: isinstance(x, Distribution))

    def sample(self, key: jax.Array) -> Any:  # noqa: D102
        leaves, structure = self._leaves()
        keys = jax.random.split(key, len(leaves))
        return structure.unflatten([d.sample(k) for d, k in zip(leaves, keys, strict=True)])

    def mode(self) -> Any:  # noqa: D102
        leaves, structure = self._leaves()
        return structure.unflatten([d.mode() for d in leaves])

    def log_prob(self, action: Any) -> jax.Array:  # noqa: D102
        leaves, structure = self._leaves()
        actions = structure.flatten_up_to(action)
        return sum(d.log_prob(a) for d, a in zip(leaves, actions, strict=True))  # type: ignore[return-value]

    def entropy(self) -> jax.Array:  # noqa: D102
        return sum(d.entropy() for d in self._leaves()[0])  # type: ignore[return-value]

    def kl(self, other: Joint) -> jax.Array:  # noqa: D102
        pairs = zip(self._leaves()[0], other._leaves()[0], strict=True)
        return sum(ours.kl(theirs) for ours, theirs in pairs)  # type: ignore[return-value]
