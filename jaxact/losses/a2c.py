"""Advantage actor-critic."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True)
class A2C(Loss):
    """Policy gradient with a value baseline, the synchronous form of A3C (Mnih et al. 2016).

    Defaults are AllenAct's: −A log π(a) + c_v ½ (V − R)² − c_e H, advantages not normalised.

    Attributes:
      value: c_v, weight of the value error.
      entropy: c_e, weight of the entropy bonus; may be a schedule of the stage's steps.
      normalize_advantage: whether advantages are normalised over the global batch.
    """

    value: float = 0.5
    entropy: float | Schedule = 0.01
    normalize_advantage: bool = False

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: policy, value, entropy."""
        advantage = batch.normalized_advantage if self.normalize_advantage else batch.advantage
        policy = -batch.mean(advantage * output.distribution.log_prob(batch.action))
        value = 0.5 * batch.mean(jnp.square(output.value - batch.returns))
        entropy = batch.mean(output.distribution.entropy())
        loss = policy + self.value * value
        loss = loss - value_at(self.entropy, progress.stage_steps) * entropy
        return loss, {"policy": policy, "value": value, "entropy": entropy}
