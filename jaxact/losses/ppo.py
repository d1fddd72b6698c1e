"""Proximal policy optimization."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True)
class PPO(Loss):
    """Clipped surrogate, clipped value error and entropy bonus (Schulman et al. 2017, equation 9).

    Defaults are AllenAct's: −min(ρA, clip(ρ, 1 ± ε)A) + c_v ½ max((V − R)², (V_clip − R)²) − c_e H.

    Attributes:
      clip: ε, the half-width of the ratio's range and of the value's; may be a schedule of the
        stage's steps.
      value: c_v, weight of the value error.
      entropy: c_e, weight of the entropy bonus; may be a schedule of the stage's steps.
      clip_value: whether the value's change is clipped too.
      normalize_advantage: whether advantages are normalised over the global batch.
    """

    clip: float | Schedule = 0.1
    value: float = 0.5
    entropy: float | Schedule = 0.01
    clip_value: bool = True
    normalize_advantage: bool = True

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: policy, value, entropy, clip_fraction, approximate_kl."""
        clip = value_at(self.clip, progress.stage_steps)
        advantage = batch.normalized_advantage if self.normalize_advantage else batch.advantage

        log_ratio = output.distribution.log_prob(batch.action) - batch.log_prob
        ratio = jnp.exp(log_ratio)
        clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
        policy = -batch.mean(jnp.minimum(ratio * advantage, clipped * advantage))

        error = jnp.square(output.value - batch.returns)
        if self.clip_value:
            near = batch.value + jnp.clip(output.value - batch.value, -clip, clip)
            error = jnp.maximum(error, jnp.square(near - batch.returns))
        value = 0.5 * batch.mean(error)

        entropy = batch.mean(output.distribution.entropy())
        loss = policy + self.value * value
        loss = loss - value_at(self.entropy, progress.stage_steps) * entropy
        return loss, {
            "policy": policy,
            "value": value,
            "entropy": entropy,
            "clip_fraction": batch.mean((jnp.abs(ratio - 1.0) > clip).astype(jnp.float32)),
            # Schulman's low-variance, non-negative estimate (ρ − 1) − log ρ.
            "approximate_kl": batch.mean((ratio - 1.0) - log_ratio),
        }
