"""Staying near a policy that is known to be good."""

from __future__ import annotations

from dataclasses import dataclass

import jax

from jaxact.losses.base import TARGET_MODEL, Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree


@dataclass(frozen=True, kw_only=True)
class KLToReference(Loss):
    """KL divergence between the policy π and a frozen reference ρ, averaged over the batch.

    By default ρ is the policy as it was when the stage began: after imitation, or with another
    run's weights. The reference has no memory of its own on the lanes: it enters each batch with
    that of the policy, so a recurrent one from a run should be what the policy began as.

    Attributes:
      run: directory of a run of the same model whose newest checkpoint is the reference; None for
        the policy itself.
      forward: whether the divergence is KL(ρ ‖ π), which keeps all that ρ would do (Baker et al.
        2022, https://arxiv.org/abs/2206.11795), or KL(π ‖ ρ), which only keeps π from what ρ would
        not do (Ziegler et al. 2019, https://arxiv.org/abs/1909.08593).
    """

    run: str | None = None
    forward: bool = True

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses policies of which the divergence is not known in closed form."""
        jax.eval_shape(lambda policy: policy.kl(policy), output.distribution)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns nothing: `follow` completes it with the reference's parameters."""
        del key, output, observation, action
        return {}

    def follow(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Returns the variables as they are; before training, the reference's parameters.

        Raises:
          JaxactError: there is no such run, or no checkpoint of such a model in it.
        """
        if TARGET_MODEL in variables:
            return variables
        return {TARGET_MODEL: params if self.run is None else _restore(self.run, params)}

    def anchor(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Returns the policy's parameters as the reference's, unless those are a run's."""
        return {TARGET_MODEL: params} if self.run is None else variables

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the divergence, `kl`."""
        del progress, variables
        policy, reference = output.distribution, output.extras["target"].distribution
        kl = batch.mean(reference.kl(policy) if self.forward else policy.kl(reference))
        return kl, {"kl": kl}


def _restore(run: str, params: PyTree) -> PyTree:
    """Returns the parameters in a run's newest checkpoint, of the shapes of `params`."""
    # Here rather than above: reading checkpoints takes a second to import.
    from jaxact.checkpoints import Checkpoints
    from jaxact.runs import open_run

    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), params)
    # Losses are initialised within a compiled function, into which these go as constants.
    with jax.ensure_compile_time_eval():
        return Checkpoints(open_run(run) / "checkpoints").restore_part(None, "params", like).state
