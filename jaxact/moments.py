"""Means and variances of all that has been seen, the same on every device."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Moments:
    """Mean and variance of a stream of arrays [...].

    Attributes:
      count: float32 scalar, how many were seen.
      mean: float32 [...].
      variance: float32 [...], 1 before any was seen.
    """

    count: jax.Array
    mean: jax.Array
    variance: jax.Array

    @staticmethod
    def of_none(*shape: int) -> Moments:
        """Returns those of a stream of which nothing was seen."""
        zeros = jnp.zeros(shape, jnp.float32)
        return Moments(jnp.zeros((), jnp.float32), zeros, jnp.ones_like(zeros))

    def update(self, values: jax.Array, axis_name: str | None) -> Moments:
        """Takes in values [T, B, ...] of every device (Chan, Golub & LeVeque 1983)."""

        def mean_of(x: jax.Array) -> jax.Array:
            mean = jnp.mean(x, axis=(0, 1))
            return mean if axis_name is None else jax.lax.pmean(mean, axis_name)

        values = values.astype(jnp.float32)
        devices = 1 if axis_name is None else jax.lax.axis_size(axis_name)
        added = jnp.float32(values.shape[0] * values.shape[1] * devices)
        mean = mean_of(values)
        variance = mean_of(jnp.square(values - mean))
        count = self.count + added
        share = added / count
        shift = mean - self.mean
        return Moments(
            count=count,
            mean=self.mean + shift * share,
            variance=(1.0 - share) * self.variance
            + share * variance
            + share * (1.0 - share) * jnp.square(shift),
        )

    def normalize(self, values: jax.Array) -> jax.Array:
        """Returns values [..., ] less the mean, in deviations, as float32."""
        return (values.astype(jnp.float32) - self.mean) / self.deviation

    @property
    def deviation(self) -> jax.Array:
        """The square root of the variance, float32 [...], not zero."""
        return jnp.sqrt(self.variance + 1e-8)


def scale_by_returns(
    moments: Moments, reward: jax.Array, discount: float | jax.Array, axis_name: str | None
) -> tuple[jax.Array, Moments]:
    """Divides rewards by the running deviation of their discounted sums.

    The sums run forward in time, R_t = γ R_{t−1} + r_t, from zero at the start of each rollout and
    through the ends of episodes.

    Args:
      moments: of all such sums before.
      reward: float32 [T, B].
      discount: γ.
      axis_name: the device axis, None on a single device.

    Returns:
      The scaled rewards, and the moments with these sums in them.
    """

    def add(total: jax.Array, reward: jax.Array) -> tuple[jax.Array, jax.Array]:
        total = discount * total + reward
        return total, total

    _, sums = jax.lax.scan(add, jnp.zeros_like(reward[0]), reward)
    moments = moments.update(sums, axis_name)
    return reward / moments.deviation, moments
