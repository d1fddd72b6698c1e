"""Proximal policy optimization."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

from jaxact.losses.base import Batch, Progress
from jaxact.losses.policy_gradient import PolicyGradient, StepTerms
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True, kw_only=True)
class PPO(PolicyGradient):
    """Clipped surrogate, clipped value error and entropy bonus (Schulman et al. 2017, equation 9).

    Defaults are AllenAct's: −min(ρA, clip(ρ, 1 ± ε)A) + c_v ½ max((V − R)², (V_clip − R)²) − c_e H.

    Attributes:
      clip: ε, the half-width of the ratio's range and of the value's; may be a schedule of the
        stage's steps.
      clip_value: whether the value's change is clipped too.
    """

    clip: float | Schedule = 0.1
    clip_value: bool = True

    def terms(self, output: ActorCriticOutput, batch: Batch, progress: Progress) -> StepTerms:
        """Returns the clipped surrogate and value error, the entropy, and as details
        clip_fraction and approximate_kl.
        """
        clip = value_at(self.clip, progress.stage_steps)
        advantage = self.advantage(batch)
        log_ratio = output.distribution.log_prob(batch.action) - batch.log_prob
        ratio = jnp.exp(log_ratio)
        clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)

        error = jnp.square(output.value - batch.returns)
        if self.clip_value:
            near = batch.value + jnp.clip(output.value - batch.value, -clip, clip)
            error = jnp.maximum(error, jnp.square(near - batch.returns))
        return StepTerms(
            policy=-jnp.minimum(ratio * advantage, clipped * advantage),
            value=0.5 * error,
            entropy=output.distribution.entropy(),
            details={
                "clip_fraction": (jnp.abs(ratio - 1.0) > clip).astype(jnp.float32),
                # Schulman's low-variance, non-negative estimate (ρ − 1) − log ρ.
                "approximate_kl": (ratio - 1.0) - log_ratio,
            },
        )
