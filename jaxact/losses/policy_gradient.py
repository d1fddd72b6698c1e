"""What policy-gradient losses share: a policy, a value and an entropy term at every step."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import jax

from jaxact.losses.base import Batch, Loss, Progress, check_actor
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True)
class StepTerms:
    """A policy-gradient loss before it is averaged; all float32 [T, B].

    Attributes:
      policy: to minimise for a better policy.
      value: error of the value.
      entropy: of the policy.
      details: what else is worth logging, by name.
    """

    policy: jax.Array
    value: jax.Array
    entropy: jax.Array
    details: dict[str, jax.Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PolicyGradient(Loss):
    """policy + c_v value − c_e entropy, averaged over the batch.

    Attributes:
      value: c_v, weight of the value error.
      entropy: c_e, weight of the entropy bonus; may be a schedule of the stage's steps.
      normalize_advantage: whether advantages are normalised over the global batch.
    """

    needs_rollout: ClassVar[bool] = True

    value: float = 0.5
    entropy: float | Schedule = 0.01
    normalize_advantage: bool = True

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without a policy of their own."""
        check_actor(self, output)

    @abstractmethod
    def terms(self, output: ActorCriticOutput, batch: Batch, progress: Progress) -> StepTerms:
        """Returns the terms at every step."""

    def advantage(self, batch: Batch) -> jax.Array:
        """Returns the advantages to use, float32 [T, B]."""
        return batch.normalized_advantage if self.normalize_advantage else batch.advantage

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: policy, value, entropy and the terms' details."""
        terms = self.terms(output, batch, progress)
        parts = {
            "policy": batch.mean(terms.policy),
            "value": batch.mean(terms.value),
            "entropy": batch.mean(terms.entropy),
        }
        loss = parts["policy"] + self.value * parts["value"]
        loss = loss - value_at(self.entropy, progress.stage_steps) * parts["entropy"]
        return loss, {**parts, **{name: batch.mean(x) for name, x in terms.details.items()}}
