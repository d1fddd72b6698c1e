"""Gradient steps: weighted losses on one forward pass, averaged over devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.pomdp import PyTree
from jaxact.schedules import Schedule, value_at

Metrics = dict[str, jax.Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Learnt:
    """What gradient steps change.

    Attributes:
      params: of the model.
      losses: variables of the losses that have some, by name and flax collection; "params" are
        trained.
      optimizer: the optimizer's state, for `trained`.
    """

    params: PyTree
    losses: dict[str, dict[str, PyTree]]
    optimizer: PyTree

    @property
    def trained(self) -> tuple[PyTree, dict[str, PyTree]]:
        """The parameters of the model, and of losses by name."""
        return self.params, {name: own.get("params", {}) for name, own in self.losses.items()}


@dataclass(frozen=True)
class GradientStep:
    """One gradient step on a batch, for `jax.lax.scan`.

    Attributes:
      model: the linen module.
      losses: by name.
      weights: of the losses, by name (default 1); numbers or schedules of the stage's steps.
      progress: how far training has come.
      optimizer: takes the gradients of `Learnt.trained`.
      prefix: of the metrics' names.
    """

    model: Any
    losses: Mapping[str, Loss]
    weights: Mapping[str, float | Schedule]
    progress: Progress
    optimizer: optax.GradientTransformation
    prefix: str = "losses"

    def __call__(self, learnt: Learnt, batch: Batch) -> tuple[Learnt, Metrics, PyTree]:
        """Returns what is learnt, metrics, and the model's memory after the batch."""
        grads, (metrics, memory) = jax.grad(self._objective, has_aux=True)(
            learnt.trained, learnt.losses, batch
        )
        flat, unflatten = ravel_pytree(grads)
        if batch.axis_name is not None:
            flat, values = jax.lax.pmean((flat, stack_metrics(metrics)), batch.axis_name)
            metrics = dict(zip(metrics, values, strict=True))
        metrics["train/gradient_norm"] = jnp.linalg.norm(flat)
        # Optimizers are others' code, which may rely on JAX's default promotion of dtypes.
        with jax.numpy_dtype_promotion("standard"):
            updates, optimizer = self.optimizer.update(
                unflatten(flat), learnt.optimizer, learnt.trained
            )
        params, own = optax.apply_updates(learnt.trained, updates)
        losses = {
            name: {**variables, "params": own[name]} if "params" in variables else variables
            for name, variables in learnt.losses.items()
        }
        return Learnt(params, losses, optimizer), metrics, memory

    def _objective(
        self, trained: tuple[PyTree, dict[str, PyTree]], variables: PyTree, batch: Batch
    ) -> tuple[jax.Array, tuple[Metrics, PyTree]]:
        """Returns the weighted sum of the losses, their metrics, and the model's memory."""
        params, own = trained
        output, memory = self.model.apply(
            params, batch.observation, batch.memory, batch.previous_action, batch.is_first
        )
        total = jnp.float32(0)
        metrics: Metrics = {}
        for name, loss in self.losses.items():
            arguments: tuple[Any, ...] = (output, batch, self.progress)
            if loss.has_variables:
                arguments += ({**variables[name], "params": own[name]},)
            value, parts = loss(*arguments)
            weight = value_at(self.weights.get(name, 1.0), self.progress.stage_steps)
            total = total + weight * value
            metrics |= {f"{self.prefix}/{name}/{part}": x for part, x in parts.items()}
            metrics[f"{self.prefix}/{name}/weight"] = weight
        metrics[f"{self.prefix}/total"] = total
        return total, (metrics, memory)


def stack_metrics(metrics: Metrics) -> jax.Array:
    """Returns metrics of one shape stacked in order, float32 [M, ...]; one array is one kernel."""
    return jnp.stack([jnp.asarray(x).astype(jnp.float32) for x in metrics.values()])
