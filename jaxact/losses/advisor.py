"""Adaptive insubordination: imitation where the expert can be followed, reward elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, Loss, Progress, check_actor
from jaxact.losses.policy_gradient import PolicyGradient
from jaxact.losses.ppo import PPO
from jaxact.models.output import ActorCriticOutput
from jaxact.schedules import Schedule, value_at


@dataclass(frozen=True, kw_only=True)
class Advisor(Loss):
    """ADVISOR (Weihs et al. 2021, https://arxiv.org/abs/2007.12173, equation 5).

    An auxiliary actor only imitates. Where it assigns the expert's action a* a low probability,
    the expert knows what the agent cannot see, and is not to be followed. At each step the weight
    of imitation is w = exp(α log π_aux(a*)), that of reinforcement learning 1 − w, and w is a
    constant to the gradient:

      CE(π_aux, a*) + mean(−w log π(a*)) + mean((1 − w) (policy − c_e entropy)) + c_v value

    Where the expert abstains, w is zero. Needs a model with an auxiliary actor,
    `ActorCritic(..., auxiliary_actor=True)`.

    Attributes:
      reinforcement: the policy-gradient loss that takes over.
      alpha: α ≥ 0, how fast w falls with the auxiliary actor's cross-entropy; 0 is imitation
        everywhere. May be a schedule of the stage's steps.
      bound: w is zero where π_aux(a*) is below it.
    """

    needs_expert: ClassVar[bool] = True
    needs_rollout: ClassVar[bool] = True

    reinforcement: PolicyGradient = field(default_factory=PPO)
    alpha: float | Schedule = 8.0
    bound: float = 0.0

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models with less than two actors."""
        _check_two_actors(self, output)

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: those of imitation and of reinforcement as they stand
        unweighted (policy, value, entropy, …), and imitation_weight, the mean w.
        """
        imitation, parts, weight = imitate(
            output, batch, value_at(self.alpha, progress.stage_steps), self.bound
        )
        rest = 1.0 - weight
        terms = self.reinforcement.terms(output, batch, progress)
        entropy = value_at(self.reinforcement.entropy, progress.stage_steps)
        learning = batch.mean(rest * (terms.policy - entropy * terms.entropy))
        value = batch.mean(terms.value)
        parts |= {"policy": batch.mean(terms.policy), "value": value}
        parts |= {"entropy": batch.mean(terms.entropy)}
        parts |= {name: batch.mean(x) for name, x in terms.details.items()}
        return imitation + learning + self.reinforcement.value * value, parts


@dataclass(frozen=True, kw_only=True)
class AdvisorImitation(Loss):
    """ADVISOR's imitation alone: for its warm start, and for demonstrations.

    CE(π_aux, a*) + mean(−w log π(a*)), with w as in `Advisor`; with α = 0, the plain cross-entropy
    of both actors.

    Attributes:
      alpha: α ≥ 0; may be a schedule of the stage's steps.
      bound: w is zero where π_aux(a*) is below it.
    """

    needs_expert: ClassVar[bool] = True

    alpha: float | Schedule = 0.0
    bound: float = 0.0

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models with less than two actors."""
        _check_two_actors(self, output)

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with cross_entropy, auxiliary_cross_entropy and imitation_weight, the
        mean w.
        """
        alpha = value_at(self.alpha, progress.stage_steps)
        imitation, parts, _ = imitate(output, batch, alpha, self.bound)
        return imitation, parts


def imitate(
    output: ActorCriticOutput, batch: Batch, alpha: jax.Array, bound: float | jax.Array
) -> tuple[jax.Array, dict[str, jax.Array], jax.Array]:
    """Returns ADVISOR's imitation loss, its parts, and the weight w, float32 [T, B]."""
    expert = batch.advice
    auxiliary = output.extras["auxiliary_distribution"].log_prob(expert.action)
    main = output.distribution.log_prob(expert.action)
    probability = jnp.exp(jax.lax.stop_gradient(auxiliary))
    weight = jnp.where(expert.valid & (probability >= bound), jnp.power(probability, alpha), 0.0)
    parts = {
        "cross_entropy": -batch.mean(main, where=expert.valid),
        "auxiliary_cross_entropy": -batch.mean(auxiliary, where=expert.valid),
        "imitation_weight": batch.mean(weight),
    }
    loss = parts["auxiliary_cross_entropy"] - batch.mean(weight * main)
    return loss, parts, weight


def _check_two_actors(loss: Loss, output: ActorCriticOutput) -> None:
    check_actor(loss, output)
    if "auxiliary_distribution" not in output.extras:
        raise JaxactError(
            "ADVISOR compares two actors; give the model a second one: "
            "ActorCritic(..., auxiliary_actor=True)"
        )
