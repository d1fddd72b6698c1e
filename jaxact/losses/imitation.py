"""Imitation of the task's expert."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput


@dataclass(frozen=True)
class Imitation(Loss):
    """Cross-entropy on the expert's actions, averaged over the steps where it does not abstain.

    With the stage's `teacher_forcing` at 0 this is behaviour cloning on the agent's own states, at
    1 behaviour cloning on the expert's, and decaying from 1 to 0 it is DAgger (Ross et al. 2011).
    """

    needs_expert: ClassVar[bool] = True

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with cross_entropy, agreement (of the modes) and advised (fraction)."""
        del progress
        if batch.expert is None:
            raise JaxactError("Imitation was given a batch without expert actions")
        valid = batch.expert.valid
        log_prob = output.distribution.log_prob(batch.expert.action)
        cross_entropy = -batch.mean(log_prob, where=valid)
        agree = jnp.stack(
            [
                jnp.all((a == b).reshape(*valid.shape, -1), axis=-1)
                for a, b in zip(
                    jax.tree.leaves(output.distribution.mode()),
                    jax.tree.leaves(batch.expert.action),
                    strict=True,
                )
            ]
        ).all(axis=0)
        return cross_entropy, {
            "cross_entropy": cross_entropy,
            "agreement": batch.mean(agree.astype(jnp.float32), where=valid),
            "advised": batch.mean(valid.astype(jnp.float32)),
        }
