"""Action distributions: registered pytrees, so that they can be vmapped, stacked and scanned.

Leading axes are batch axes; the event axes are those of one action.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
        """Draws int32 [batch]."""
        return _draw(key, jax.nn.softmax(self.logits))

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
class EpsilonGreedy(Distribution):
    """Over 0 … n − 1: the action of the highest value, or with probability ε any at random.

    Attributes:
      values: float32 [batch, n].
      epsilon: ε, float32 [batch].
    """

    values: jax.Array
    epsilon: jax.Array

    @property
    def probabilities(self) -> jax.Array:
        """float32 [batch, n]."""
        actions = self.values.shape[-1]
        epsilon = self.epsilon[..., None]
        return (1.0 - epsilon) * jax.nn.one_hot(self.mode(), actions) + epsilon / actions

    def sample(self, key: jax.Array) -> jax.Array:  # noqa: D102
        return _draw(key, self.probabilities)

    def mode(self) -> jax.Array:  # noqa: D102
        return jnp.argmax(self.values, axis=-1).astype(jnp.int32)

    def log_prob(self, action: jax.Array) -> jax.Array:  # noqa: D102
        chosen = jax.nn.one_hot(action, self.values.shape[-1])
        return jnp.log(jnp.sum(self.probabilities * chosen, axis=-1))

    def entropy(self) -> jax.Array:  # noqa: D102
        probabilities = self.probabilities
        return -jnp.sum(jax.scipy.special.xlogy(probabilities, probabilities), axis=-1)


def explore(distribution: Distribution, epsilon: jax.Array) -> EpsilonGreedy:
    """Returns the distribution with another ε, float32 scalar.

    Raises:
      JaxactError: it is none of those that have one.
    """
    if not isinstance(distribution, EpsilonGreedy):
        raise JaxactError(
            "a stage's exploration is for models that choose greedily, such as QNetwork; "
            f"{type(distribution).__name__} explores by itself"
        )
    return replace(distribution, epsilon=jnp.broadcast_to(epsilon, distribution.epsilon.shape))


def _draw(key: jax.Array, probabilities: jax.Array) -> jax.Array:
    """Draws int32 [batch] by inverting the cumulative sum: one uniform number an action."""
    cumulative = jnp.cumsum(probabilities, axis=-1)
    uniform = jax.random.uniform(key, (*probabilities.shape[:-1], 1), jnp.float32)
    # Scaling by the last sum keeps the draw inside the support whatever the rounding.
    below = cumulative <= uniform * cumulative[..., -1:]
    return jnp.minimum(
        jnp.sum(below, axis=-1, dtype=jnp.int32), jnp.int32(probabilities.shape[-1] - 1)
    )


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


# Of the expectation over a standard normal, exact for polynomials up to degree 31.
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(16)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SquashedNormal(Distribution):
    """Independent normals u, squashed into a box: a = centre + half · tanh(u).

    Log-probabilities are those of a, by the change of variables; of Haarnoja et al. 2018,
    appendix C (https://arxiv.org/abs/1801.01290), in the form that does not lose precision where
    tanh saturates: log(1 − tanh²u) = 2 (log 2 − u − softplus(−2u)).

    Attributes:
      mean: of u, float32 [batch, d].
      log_std: of u, float32 [batch, d].
      centre: of the box, float32, broadcastable to `mean`.
      half: half the box's width, float32, broadcastable to `mean`.
    """

    mean: jax.Array
    log_std: jax.Array
    centre: jax.Array
    half: jax.Array

    def sample_with_log_prob(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Draws an action, differentiable by the parameters, and returns its log-probability.

        Unlike `log_prob`, it need not find the u of an action, of which rounding at the box's edges
        leaves little.
        """
        noise = jax.random.normal(key, self.mean.shape, self.mean.dtype)
        u = self.mean + jnp.exp(self.log_std) * noise
        return self._squash(u), self._log_prob(u)

    def sample(self, key: jax.Array) -> jax.Array:  # noqa: D102
        return self.sample_with_log_prob(key)[0]

    def mode(self) -> jax.Array:
        """Returns the squashed mean: the median, where the density has its peak elsewhere."""
        return self._squash(self.mean)

    def log_prob(self, action: jax.Array) -> jax.Array:
        """Returns the log-density of `action`, at the box's very edges that of just inside."""
        inside = jnp.clip((action - self.centre) / self.half, -1.0 + 1e-6, 1.0 - 1e-6)
        return self._log_prob(jnp.arctanh(inside))

    def entropy(self) -> jax.Array:
        """Returns the entropy: the normal's in closed form, the squashing's by quadrature."""
        log_std = jnp.broadcast_to(self.log_std, self.mean.shape)
        nodes = jnp.asarray(_NODES, self.mean.dtype)
        u = self.mean[..., None] + jnp.exp(log_std)[..., None] * nodes
        weights = jnp.asarray(_WEIGHTS / _WEIGHTS.sum(), self.mean.dtype)
        squashing = jnp.sum(_log_slope_of_tanh(u) * weights, axis=-1) + jnp.log(self.half)
        return jnp.sum(log_std + 0.5 * jnp.log(2 * jnp.pi * jnp.e) + squashing, axis=-1)

    def kl(self, other: SquashedNormal) -> jax.Array:
        """Returns that of the normals, which squashing into the same box leaves as it is."""
        return DiagonalNormal(self.mean, self.log_std).kl(DiagonalNormal(other.mean, other.log_std))

    def _squash(self, u: jax.Array) -> jax.Array:
        return self.centre + self.half * jnp.tanh(u)

    def _log_prob(self, u: jax.Array) -> jax.Array:
        normal = DiagonalNormal(self.mean, self.log_std).log_prob(u)
        return normal - jnp.sum(_log_slope_of_tanh(u) + jnp.log(self.half), axis=-1)


def _log_slope_of_tanh(u: jax.Array) -> jax.Array:
    return 2.0 * (jnp.log(2.0) - u - jax.nn.softplus(-2.0 * u))


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
