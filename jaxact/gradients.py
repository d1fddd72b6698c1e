"""Gradient steps: weighted losses on one forward pass, averaged over devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from jaxact.agents import as_lanes, batch_of_lanes
from jaxact.losses.base import PRIORITY, TARGET_MODEL, Batch, Following, Loss, Progress
from jaxact.models.normalized import held
from jaxact.models.output import ActorCriticOutput
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

    def with_trained(self, trained: tuple[PyTree, dict[str, PyTree]]) -> Learnt:
        """Returns the same with other parameters, and the optimizer's state as it is."""
        params, own = trained
        losses = {
            name: {**variables, "params": own[name]} if "params" in variables else variables
            for name, variables in self.losses.items()
        }
        return replace(self, params=params, losses=losses)


@dataclass(frozen=True)
class GradientStep:
    """One gradient step on a batch, for `jax.lax.scan`.

    Where there are several agents, the model sees their axis and losses see lanes.

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

    def __call__(
        self, learnt: Learnt, batch: Batch
    ) -> tuple[Learnt, Metrics, PyTree, jax.Array | None]:
        """Returns what is learnt, metrics, the model's memory after the batch, and the sequences'
        priorities [B] where a loss tells them: their weighted sum over the losses.
        """
        grads, (metrics, memory, priority) = jax.grad(self._objective, has_aux=True)(
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
        learnt = learnt.with_trained(optax.apply_updates(learnt.trained, held(updates)))
        losses = dict(learnt.losses)
        for name, loss in self.losses.items():
            if isinstance(loss, Following):
                losses[name] = loss.follow(losses[name], learnt.params)
        return Learnt(learnt.params, losses, optimizer), metrics, memory, priority

    def _objective(
        self, trained: tuple[PyTree, dict[str, PyTree]], variables: PyTree, batch: Batch
    ) -> tuple[jax.Array, tuple[Metrics, PyTree, jax.Array | None]]:
        """Returns the weighted sum of the losses, metrics, the model's memory, and priorities."""
        params, own = trained
        whole = batch
        output, memory = forward(self.model, params, whole)
        if batch.terminated.ndim > batch.is_first.ndim:
            batch, output = batch_of_lanes(whole, output)
        total, priority = jnp.float32(0), None
        metrics: Metrics = {}
        for name, loss in self.losses.items():
            arguments: tuple[Any, ...] = (output, batch, self.progress)
            if loss.has_variables:
                arguments += ({**variables[name], "params": own[name]},)
                if TARGET_MODEL in variables[name]:
                    target, _ = forward(self.model, variables[name][TARGET_MODEL], whole)
                    target = as_lanes(target, 2) if batch is not whole else target
                    extras = {**output.extras, "target": target}
                    arguments = (replace(output, extras=extras), *arguments[1:])
            value, parts = loss(*arguments)
            weight = value_at(self.weights.get(name, 1.0), self.progress.stage_steps)
            total = total + weight * value
            if PRIORITY in parts:
                told = jax.lax.stop_gradient(weight * parts.pop(PRIORITY))
                priority = told if priority is None else priority + told
            metrics |= {f"{self.prefix}/{name}/{part}": x for part, x in parts.items()}
            metrics[f"{self.prefix}/{name}/weight"] = weight
        metrics[f"{self.prefix}/total"] = total
        return total, (metrics, memory, priority)


def forward(model: Any, params: PyTree, batch: Batch) -> tuple[ActorCriticOutput, PyTree]:
    """Returns the model's output on a batch, [T, B], and its memory after it.

    No gradient reaches what the model makes of the batch's burn-in.
    """
    memory, early = batch.memory, batch.burn_in
    if early is not None:
        _, memory = model.apply(
            params, early.observation, memory, early.previous_action, early.is_first
        )
        memory = jax.lax.stop_gradient(memory)
    return model.apply(params, batch.observation, memory, batch.previous_action, batch.is_first)


def stack_metrics(metrics: Metrics) -> jax.Array:
    """Returns metrics of one shape stacked in order, float32 [M, ...]; one array is one kernel."""
    return jnp.stack([jnp.asarray(x).astype(jnp.float32) for x in metrics.values()])
