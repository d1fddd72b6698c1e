"""What every loss sees: the model's output on a batch, the batch, and how far training has come."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import ExpertAction


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Progress:
    """How far training has come, in environment steps.

    Attributes:
      stage_steps: float32 scalar, steps taken in this stage.
      total_steps: float32 scalar, steps taken in all stages.
    """

    stage_steps: jax.Array
    total_steps: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """Whole sequences of some lanes; every array is time-major [T, B, ...].

    Attributes:
      observation: named sensor readings that the actions answered to.
      previous_action: the action before each.
      is_first: bool, true at the first step of an episode.
      memory: the model's memory before the first step, [B, ...].
      action: what was done.
      log_prob: float32, its log-probability when it was done.
      value: float32, the value then estimated.
      reward: float32.
      reward_terms: the reward's named components, float32.
      terminated: bool.
      truncated: bool.
      advantage: float32, generalized advantage.
      normalized_advantage: float32, the same with mean 0 and deviation 1 over all lanes of all
        devices.
      returns: float32, advantage + value.
      expert: the expert's advice, None where no loss of the stage asks for it.
      axis_name: name of the device axis that `mean` averages over, None on a single device.
    """

    observation: dict[str, jax.Array]
    previous_action: Any
    is_first: jax.Array
    memory: Any
    action: Any
    log_prob: jax.Array
    value: jax.Array
    reward: jax.Array
    reward_terms: Any
    terminated: jax.Array
    truncated: jax.Array
    advantage: jax.Array
    normalized_advantage: jax.Array
    returns: jax.Array
    expert: ExpertAction | None
    axis_name: str | None = field(metadata={"static": True})

    def mean(self, values: jax.Array, where: jax.Array | None = None) -> jax.Array:
        """Returns this device's share of the mean of `values` [T, B] over the global batch.

        Averaged over devices, the shares are the mean over all entries (those where `where` holds;
        zero when there are none), whichever device holds them.
        """
        if where is None:
            return jnp.mean(values)
        held = jnp.mean(where.astype(jnp.float32))
        if self.axis_name is not None:
            held = jax.lax.pmean(held, self.axis_name)
        # Less than one entry in the whole batch means none at all.
        return jnp.mean(jnp.where(where, values, 0.0)) / jnp.maximum(held, 1e-9)


class Loss(ABC):
    """A training objective on the shared forward pass of the model.

    A loss is a frozen dataclass; its float fields are data that may be swept without recompiling.
    """

    needs_expert: ClassVar[bool] = False

    @abstractmethod
    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the scalar to minimise and named scalars to log.

        `output` is that of the parameters being trained, [T, B, ...]. Means are to be taken with
        `batch.mean`, so that the loss is that of the global batch on any number of devices.
        """
