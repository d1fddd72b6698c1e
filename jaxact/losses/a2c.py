"""Advantage actor-critic."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

from jaxact.losses.base import Batch, Progress
from jaxact.losses.policy_gradient import PolicyGradient, StepTerms
from jaxact.models.output import ActorCriticOutput


@dataclass(frozen=True, kw_only=True)
class A2C(PolicyGradient):
    """Policy gradient with a value baseline, the synchronous form of A3C (Mnih et al. 2016).

    Defaults are AllenAct's: −A log π(a) + c_v ½ (V − R)² − c_e H, advantages not normalised.
    """

    normalize_advantage: bool = False

    def terms(self, output: ActorCriticOutput, batch: Batch, progress: Progress) -> StepTerms:
        """Returns −A log π(a), ½ (V − R)² and the entropy."""
        del progress
        return StepTerms(
            policy=-self.advantage(batch) * output.distribution.log_prob(batch.action),
            value=0.5 * jnp.square(output.value - batch.returns),
            entropy=output.distribution.entropy(),
        )
