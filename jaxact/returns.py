"""Returns and advantages, as functions of time-major arrays [T, ...]."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp


def generalized_advantages(
    r_t: jax.Array,
    v_tm1: jax.Array,
    v_t: jax.Array,
    terminated_t: jax.Array,
    finished_t: jax.Array,
    discount: float | jax.Array,
    lambda_: float | jax.Array,
) -> jax.Array:
    """Generalized advantage estimation, with truncation bootstrapped and termination not.

    δₜ = rₜ + γ (1 − terminatedₜ) v(sₜ) − v(sₜ₋₁) and Aₜ = δₜ + γ λ (1 − finishedₜ) Aₜ₊₁, after
    Schulman et al. 2016, equations 11 and 16 (https://arxiv.org/abs/1506.02438).

    Args:
      r_t: float32 [T, ...], rewards of the steps.
      v_tm1: float32 [T, ...], values of the states stepped from.
      v_t: float32 [T, ...], values of the states stepped to; at the end of an episode that of its
        final state, never that of the next episode's first.
      terminated_t: bool [T, ...], the task ended: the state's value is zero.
      finished_t: bool [T, ...], the episode ended, terminated or truncated.
      discount: γ in [0, 1].
      lambda_: λ in [0, 1].

    Returns:
      float32 [T, ...].
    """
    chex.assert_equal_shape([r_t, v_tm1, v_t, terminated_t, finished_t])
    delta_t = r_t + discount * jnp.where(terminated_t, 0.0, v_t) - v_tm1
    decay_t = discount * lambda_ * jnp.where(finished_t, 0.0, jnp.ones_like(r_t))

    def backward(
        advantage: jax.Array, x: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        delta, decay = x
        advantage = delta + decay * advantage
        return advantage, advantage

    _, advantages = jax.lax.scan(
        backward, jnp.zeros_like(delta_t[0]), (delta_t, decay_t), reverse=True
    )
    return advantages


def episode_means(x_t: jax.Array, finished_t: jax.Array) -> jax.Array:
    """Returns at each step the mean of `x_t` over the episode's steps so far, float32 [T, ...].

    Args:
      x_t: float32 [T, ...].
      finished_t: bool [T, ...], the episode ended with this step.
    """
    chex.assert_equal_shape([x_t, finished_t])

    def forward(
        carry: tuple[jax.Array, jax.Array], step: tuple[jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        total, count = carry
        x, finished = step
        total, count = total + x, count + 1
        going_on = jnp.where(finished, 0.0, jnp.ones_like(x))
        return (total * going_on, count * going_on), total / count

    nothing = jnp.zeros_like(x_t[0])
    return jax.lax.scan(forward, (nothing, nothing), (x_t, finished_t))[1]
