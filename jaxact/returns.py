"""Returns and advantages, as functions of time-major arrays [T, ...]."""

from __future__ import annotations

from typing import NamedTuple

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


def n_step_returns(
    r_t: jax.Array,
    v_tm1: jax.Array,
    terminated_t: jax.Array,
    known_t: jax.Array,
    discount: float | jax.Array,
    n: int,
) -> jax.Array:
    """Sums of the next n rewards and of the discounted value of the state after them.

    G⁰ₜ = v(sₜ₋₁) and Gᵏₜ = rₜ + γ (1 − terminatedₜ) Gᵏ⁻¹ₜ₊₁; where it is not known what a step led
    to, Gᵏₜ = v(sₜ₋₁). So sums are shorter than n before such a step, and there the return is no
    target: it is the value itself.

    Args:
      r_t: float32 [T, ...], rewards of the steps.
      v_tm1: float32 [T, ...], values of the states stepped from.
      terminated_t: bool [T, ...], the task ended: nothing is bootstrapped.
      known_t: bool [T, ...], the next row is what the step led to, or it terminated; see
        `known_transitions`.
      discount: γ in [0, 1].
      n: at least 1.

    Returns:
      float32 [T, ...].
    """
    chex.assert_equal_shape([r_t, v_tm1, terminated_t, known_t])
    returns = v_tm1
    for _ in range(n):
        after = jnp.where(terminated_t, 0.0, _next_row(returns))
        returns = jnp.where(known_t, r_t + discount * after, v_tm1)
    return returns


def known_transitions(terminated_t: jax.Array, truncated_t: jax.Array) -> jax.Array:
    """Returns of which steps [T, ...] of a sequence it tells what they led to, bool.

    Not of the last, nor of those that were truncated, after which comes another episode; but of
    those that terminated it is known that no reward follows.
    """
    chex.assert_equal_shape([terminated_t, truncated_t])
    last = jnp.zeros_like(terminated_t).at[-1].set(True)
    return terminated_t | ~(truncated_t | last)


class VTrace(NamedTuple):
    """What `vtrace` returns, float32 [T, ...].

    Attributes:
      values: targets of the value.
      advantages: of the actions, times their clipped ratios.
    """

    values: jax.Array
    advantages: jax.Array


def vtrace(
    r_t: jax.Array,
    v_tm1: jax.Array,
    log_ratio_t: jax.Array,
    terminated_t: jax.Array,
    known_t: jax.Array,
    discount: float | jax.Array,
    lambda_: float | jax.Array = 1.0,
    clip: float | jax.Array = 1.0,
) -> VTrace:
    """V-trace, for sequences on which an earlier policy acted.

    After Espeholt et al. 2018, section 4 (https://arxiv.org/abs/1802.01561), with ρ̄ = c̄ = `clip`:
    ρₜ = min(clip, πₜ / μₜ), δₜ = ρₜ (rₜ + γ v(sₜ) − v(sₜ₋₁)), vsₜ = v(sₜ₋₁) + δₜ + γ λ ρₜ (vsₜ₊₁ −
    v(sₜ)), and the advantage ρₜ (rₜ + γ vsₜ₊₁ − v(sₜ₋₁)). Where it is not known what a step led to,
    the target is v(sₜ₋₁) and the advantage zero.

    Args:
      r_t: float32 [T, ...], rewards of the steps.
      v_tm1: float32 [T, ...], values of the states stepped from.
      log_ratio_t: float32 [T, ...], log π − log μ of the actions taken.
      terminated_t: bool [T, ...], the task ended: nothing is bootstrapped.
      known_t: bool [T, ...], see `known_transitions`.
      discount: γ in [0, 1].
      lambda_: λ in [0, 1].
      clip: at least 0.
    """
    chex.assert_equal_shape([r_t, v_tm1, log_ratio_t, terminated_t, known_t])
    ratio_t = jnp.minimum(jnp.exp(log_ratio_t), clip)
    discount_t = discount * jnp.where(terminated_t, 0.0, jnp.ones_like(r_t))
    v_t = _next_row(v_tm1)
    delta_t = jnp.where(known_t, ratio_t * (r_t + discount_t * v_t - v_tm1), 0.0)
    decay_t = jnp.where(known_t, discount_t * lambda_ * ratio_t, 0.0)

    def backward(error: jax.Array, x: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, decay = x
        error = delta + decay * error
        return error, error

    _, errors = jax.lax.scan(backward, jnp.zeros_like(r_t[0]), (delta_t, decay_t), reverse=True)
    values = v_tm1 + errors
    advantages = ratio_t * (r_t + discount_t * _next_row(values) - v_tm1)
    return VTrace(values, jnp.where(known_t, advantages, 0.0))


def _next_row(x_t: jax.Array) -> jax.Array:
    """Returns xₜ₊₁ in place of xₜ; the last row is kept, and is not to be used."""
    return jnp.concatenate([x_t[1:], x_t[-1:]])
