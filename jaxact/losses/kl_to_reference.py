"""Staying near a policy that is known to be good."""

from __future__ import annotations

from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree


@dataclass(frozen=True, kw_only=True)
class KLToReference(Loss):
    """KL divergence between the policy π and a frozen reference ρ, averaged over the batch.

    By default ρ is the policy as it was when the stage began: after imitation, or with another
    run's weights. The reference has no memory of its own on the lanes: it enters each batch with
    that of the policy, so a recurrent one from a run should be what the policy began as.

    Attributes:
      model: the reference's module, with the same memory as the policy's.
      run: directory of a run whose newest checkpoint is the reference; None for the policy itself.
      forward: whether the divergence is KL(ρ ‖ π), which keeps all that ρ would do (Baker et al.
        2022, https://arxiv.org/abs/2206.11795), or KL(π ‖ ρ), which only keeps π from what ρ would
        not do (Ziegler et al. 2019, https://arxiv.org/abs/1909.08593).
    """

    model: nn.Module
    run: str | None = None
    forward: bool = True

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the reference's parameters; zeros where the stage's beginning sets them.

        Raises:
          JaxactError: there is no such run, or no checkpoint of such a model in it.
        """
        del output
        inputs = (observation, self.model.initial_memory(1), action, jnp.ones(1, bool))
        like = jax.eval_shape(self.model.init, key, *inputs)
        if self.run is None:
            return {"reference": jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), like)}
        return {"reference": _restore(self.run, like)}

    def anchor(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Returns the policy's parameters as the reference's, unless those are a run's."""
        return {"reference": params} if self.run is None else variables

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the divergence, `kl`."""
        del progress
        inputs = (batch.observation, batch.memory, batch.previous_action, batch.is_first)
        reference, _ = self.model.apply(variables["reference"], *inputs)
        policy, frozen = output.distribution, jax.lax.stop_gradient(reference.distribution)
        kl = batch.mean(frozen.kl(policy) if self.forward else policy.kl(frozen))
        return kl, {"kl": kl}


def _restore(run: str, like: PyTree) -> PyTree:
    """Returns the parameters in a run's newest checkpoint."""
    # Here rather than above: reading checkpoints takes a second to import.
    from jaxact.checkpoints import Checkpoints
    from jaxact.runs import open_run

    # Losses are initialised within a compiled function, into which these go as constants.
    with jax.ensure_compile_time_eval():
        return Checkpoints(open_run(run) / "checkpoints").restore_part(None, "params", like).state
