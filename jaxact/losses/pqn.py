"""Q-learning from rollouts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.dqn import action_values, of_action
from jaxact.models.output import ActorCriticOutput


@dataclass(frozen=True)
class PQN(Loss):
    """Parallelised Q-network (Gallici et al. 2024, https://arxiv.org/abs/2407.04811).

    ½ (Q(s, a) − R)² against the Q(λ) returns of the rollout, Rₜ = rₜ + γ ((1 − λ) max Q(sₜ₊₁) +
    λ Rₜ₊₁): without replay, without a target network. As the model's value is max Q, these are the
    batch's `returns`, with the pipeline's discount and `gae_lambda`, and truncated episodes are
    bootstrapped from their final observation. Needs `QNetwork(layer_norm=True)` to be stable.
    """

    needs_rollout: ClassVar[bool] = True

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without action values."""
        action_values(output)

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with error (mean |R − Q|) and q (mean Q)."""
        del progress
        chosen = of_action(action_values(output), batch.action)
        error = batch.returns - chosen
        loss = 0.5 * batch.mean(jnp.square(error))
        return loss, {"error": batch.mean(jnp.abs(error)), "q": batch.mean(chosen)}
