"""Keeps a model with several beliefs from relying on one of them."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput


@dataclass(frozen=True)
class FusionEntropy(Loss):
    """Negative entropy Σ w log w of the weights with which beliefs are fused (Ye et al. 2020,
    https://arxiv.org/abs/2007.04561); AllenAct weighs it 0.01.

    Needs a model with several beliefs, `ActorCritic(..., memory=MultipleBeliefs(...))`.
    """

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models with one belief."""
        if "fusion" not in output.extras:
            raise JaxactError(
                "the entropy of a fusion needs a model with several beliefs; give it some: "
                "ActorCritic(..., memory=MultipleBeliefs(...))"
            )

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with entropy and each belief's mean weight."""
        del progress
        weights = output.extras["fusion"]
        # The limit of w log w at 0 is 0.
        terms = [w * jnp.log(jnp.maximum(w, 1e-12)) for w in weights.values()]
        loss = batch.mean(sum(terms, start=jnp.float32(0)))
        means = {f"weight/{name}": batch.mean(w) for name, w in weights.items()}
        return loss, {"entropy": -loss, **means}
