"""Imitation of the task's expert."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.distributions import Categorical
from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, Loss, Progress, check_actor
from jaxact.models.output import ActorCriticOutput


@dataclass(frozen=True)
class Imitation(Loss):
    """Cross-entropy on the expert's actions, averaged over the steps where it does not abstain.

    Of an expert that gives its whole policy p, the cross-entropy is −Σ p(a) log π(a).

    With the stage's `teacher_forcing` at 0 this is behaviour cloning on the agent's own states, at
    1 behaviour cloning on the expert's, and decaying from 1 to 0 it is DAgger (Ross et al. 2011).
    """

    needs_expert: ClassVar[bool] = True

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without a policy of their own."""
        check_actor(self, output)

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with cross_entropy, agreement (of the modes) and advised (fraction)."""
        del progress
        expert = batch.advice
        if expert.policy is None:
            log_prob = output.distribution.log_prob(expert.action)
        else:
            log_probs = jax.nn.log_softmax(_categorical(output).logits)
            log_prob = jnp.sum(expert.policy * log_probs, axis=-1)
        cross_entropy = -batch.mean(log_prob, where=expert.valid)
        agree = jnp.stack(
            [
                jnp.all((a == b).reshape(*expert.valid.shape, -1), axis=-1)
                for a, b in zip(
                    jax.tree.leaves(output.distribution.mode()),
                    jax.tree.leaves(expert.action),
                    strict=True,
                )
            ]
        ).all(axis=0)
        return cross_entropy, {
            "cross_entropy": cross_entropy,
            "agreement": batch.mean(agree.astype(jnp.float32), where=expert.valid),
            "advised": batch.mean(expert.valid.astype(jnp.float32)),
        }


@dataclass(frozen=True)
class GroupedImitation(Loss):
    """Imitation of what group of actions the expert's is in: −log Σ π(a) over the group.

    For discrete actions of which several are as good (AllenAct's `GroupedActionImitation`).

    Attributes:
      groups: a partition of the actions; those that are in no group are a group each.
    """

    needs_expert: ClassVar[bool] = True

    groups: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "groups", tuple(tuple(group) for group in self.groups))
        listed = [action for group in self.groups for action in group]
        if len(set(listed)) < len(listed) or min(listed, default=0) < 0 or () in self.groups:
            raise JaxactError(
                f"groups of actions must be disjoint, and each of one or more numbers from 0; "
                f"got {self.groups}"
            )

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses policies that are not categorical, and actions that there are not."""
        actions = _categorical(output).logits.shape[-1]
        highest = max((action for group in self.groups for action in group), default=0)
        if highest >= actions:
            raise JaxactError(f"there are {actions} actions, so none is {highest}")

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with cross_entropy and advised (fraction)."""
        del progress
        expert, distribution = batch.advice, _categorical(output)
        together = np.eye(distribution.logits.shape[-1], dtype=bool)
        for group in self.groups:
            together[np.ix_(group, group)] = True
        log_probs = jax.nn.log_softmax(distribution.logits)
        in_group = jnp.asarray(together)[expert.action]
        log_prob = jax.nn.logsumexp(jnp.where(in_group, log_probs, -jnp.inf), axis=-1)
        cross_entropy = -batch.mean(log_prob, where=expert.valid)
        advised = batch.mean(expert.valid.astype(jnp.float32))
        return cross_entropy, {"cross_entropy": cross_entropy, "advised": advised}


def _categorical(output: ActorCriticOutput) -> Categorical:
    if not isinstance(output.distribution, Categorical):
        raise JaxactError(
            "expert policies and groups of actions are for discrete actions, not for "
            f"{type(output.distribution).__name__}"
        )
    return output.distribution
