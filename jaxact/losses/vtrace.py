"""Policy gradient on what an earlier policy did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxact import returns
from jaxact.losses.base import Batch, Loss, Progress, check_actor
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True, kw_only=True)
class VTrace(Loss):
    """IMPALA's actor-critic with V-trace corrections (Espeholt et al. 2018, section 4.2).

    −A log π(a) + c_v ½ (V − vs)² − c_e H, with targets vs and advantages A of `returns.vtrace` for
    the present policy and the log-probabilities with which the actions were taken. For a small
    `Replay` of recent rollouts, or the rollout itself; it must not hold actions that were forced.
    A step's successor is the next row, so that the last step of a sequence and those that were
    truncated are not learnt from.

    Attributes:
      value: c_v, weight of the value error.
      entropy: c_e, weight of the entropy bonus; may be a schedule of the stage's steps.
      discount: γ.
      lambda_: λ.
      clip: the greatest ratio of probabilities.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"log_prob", "reward"})

    value: float = 0.5
    entropy: float | Schedule = 0.01
    discount: float = 0.99
    lambda_: float = 1.0
    clip: float = 1.0

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without a policy of their own."""
        check_actor(self, output)

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: policy, value, entropy and ratio (mean, not clipped)."""
        log_prob = output.distribution.log_prob(batch.action)
        log_ratio = log_prob - batch.log_prob
        known = returns.known_transitions(batch.terminated, batch.truncated)
        target = jax.lax.stop_gradient(
            returns.vtrace(
                batch.reward,
                output.value,
                log_ratio,
                batch.terminated,
                known,
                self.discount,
                self.lambda_,
                self.clip,
            )
        )
        parts = {
            "policy": -batch.mean(target.advantages * log_prob, where=known),
            "value": 0.5 * batch.mean(jnp.square(output.value - target.values), where=known),
            "entropy": batch.mean(output.distribution.entropy(), where=known),
            "ratio": batch.mean(jnp.exp(log_ratio), where=known),
        }
        loss = parts["policy"] + self.value * parts["value"]
        return loss - value_at(self.entropy, progress.stage_steps) * parts["entropy"], parts
