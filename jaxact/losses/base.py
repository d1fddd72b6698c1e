"""What every loss sees: the model's output on a batch, the batch, and how far training has come."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from jaxact.distributions import EpsilonGreedy
from jaxact.errors import JaxactError
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import ExpertAction, PyTree

# Of the named numbers that a loss returns, the one that is not logged: float32 [B], how much there
# is to learn from each sequence, for the storage that it came from.
PRIORITY = "priority"
# The collection of a loss's variables that holds parameters of the model, to compare with.
TARGET_MODEL = "target_model"


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
class BurnIn:
    """Steps that nothing is learnt from but what the model remembers of them, [T, B, ...].

    Attributes:
      observation, previous_action, is_first: as in `Batch`.
    """

    observation: dict[str, jax.Array]
    previous_action: Any
    is_first: jax.Array


@jax.tree_util.register_static
@dataclass(frozen=True)
class Unknown:
    """Stands in a batch for an array that nobody kept; whoever computes with it is told why.

    (NaN would be no safeguard: of constants that are NaN, XLA makes finite numbers on CPUs.)

    Attributes:
      why: one sentence.
    """

    why: str

    def __jax_array__(self) -> jax.Array:
        raise JaxactError(self.why)

    def __getitem__(self, index: Any) -> Any:
        raise JaxactError(self.why)

    def __getattr__(self, name: str) -> Any:
        # What Python and JAX look for to see what an object can do is honestly not there.
        raise AttributeError(name) if name.startswith("__") else JaxactError(self.why)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """Whole sequences of some lanes; every array is time-major [T, B, ...].

    Of several agents it is [T, B, A, ...], but for `is_first`, `memory`, `key` and `weight`, until
    `jaxact.agents.batch_of_lanes` makes lanes of them; losses see no axis of agents.

    What only the policy that acted could tell (log_prob, value, and advantage and returns, which
    are made from it) is `Unknown` in batches that come from a storage which does not keep it.

    Attributes:
      observation: named sensor readings that the actions answered to.
      previous_action: the action before each.
      is_first: bool, true at the first step of an episode.
      memory: the model's memory before the first step (of `burn_in`, where there is one), [B, ...].
      action: what was done.
      log_prob: float32, its log-probability when it was done.
      value: float32, the value then estimated.
      reward: float32, the sum of `reward_terms`, each times its weight in the stage.
      reward_terms: the reward's named components, float32, those of losses among them.
      terminated: bool.
      truncated: bool.
      advantage: float32, generalized advantage.
      normalized_advantage: float32, the same with mean 0 and deviation 1 over all lanes of all
        devices.
      returns: float32, advantage + value.
      expert: the expert's advice, None where no loss of the stage asks for it.
      key: PRNG key of each lane, [B], another one in each epoch.
      axis_name: name of the device axis that `mean` averages over, None on a single device.
      burn_in: the steps before the first, None if the memory is that of the first.
      weight: float32 [B], what each sequence counts in `mean`; None if they all count one.
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
    key: jax.Array
    axis_name: str | None = field(metadata={"static": True})
    burn_in: BurnIn | None = None
    weight: jax.Array | None = None

    @property
    def advice(self) -> ExpertAction:
        """The expert's actions.

        Raises:
          JaxactError: nobody asked for them.
        """
        if self.expert is None:
            raise JaxactError("a loss that imitates was given a batch without expert actions")
        return self.expert

    def lanes_of_all_devices(self, values: jax.Array) -> jax.Array:
        """Returns `values` [T, B, ...] beside those of the other devices, [T, B of all, ...]."""
        if self.axis_name is None:
            return values
        gathered: jax.Array = jax.lax.all_gather(values, self.axis_name, axis=1, tiled=True)
        return gathered

    def lanes_of_this_device(self, values: jax.Array) -> jax.Array:
        """Returns the lanes of this batch [T, B, ...] of what holds those of all devices."""
        if self.axis_name is None:
            return values
        lanes = self.is_first.shape[1]
        start = jax.lax.axis_index(self.axis_name) * lanes
        own: jax.Array = jax.lax.dynamic_slice_in_dim(values, start, lanes, axis=1)
        return own

    def mean(self, values: jax.Array, where: jax.Array | None = None) -> jax.Array:
        """Returns this device's share of the mean of `values` [T, B] over the global batch.

        Averaged over devices, the shares are the mean over all entries (those where `where` holds;
        zero when there are none), each times its sequence's `weight`, whichever device holds them.
        """
        if self.weight is not None:
            values = values * self.weight
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
    One that learns something of its own (a discriminator, a predictor) overrides `init`, and is
    then called with a fourth argument, its variables.

    Attributes:
      needs_expert: whether the expert must be asked at every step.
      needs_rollout: whether it means something only on what the policy itself has just done.
      needs: names of fields of `Batch` that it reads and that not all storages know: log_prob,
        reward.
      tells_priority: whether it tells, under `PRIORITY`, how much there is to learn from sequences.
    """

    needs_expert: ClassVar[bool] = False
    needs_rollout: ClassVar[bool] = False
    needs: ClassVar[frozenset[str]] = frozenset()
    tells_priority: ClassVar[bool] = False

    @property
    def has_variables(self) -> bool:
        """Whether it has variables of its own; by default, whether `init` is overridden."""
        return type(self).init is not Loss.init

    @property
    def least_length(self) -> int:
        """Steps of the shortest sequence that it learns anything from; by default one."""
        return 1

    def check_model(self, output: ActorCriticOutput) -> None:
        """Finds that it cannot learn with a model, before anything compiles; by default it can.

        Args:
          output: of the model, with shapes and dtypes in place of arrays.

        Raises:
          JaxactError: the model lacks what the loss works on.
        """
        del output

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the loss's own variables, as flax does: the collection "params" is trained with
        the model, by the same optimizer; others change only where the loss itself changes them.
        Where there is a collection `TARGET_MODEL`, of parameters of the model, the model's output
        with them on the batch is given to the loss as `output.extras["target"]`.

        Losses of one name in several stages share their variables.

        Args:
          key: a PRNG key.
          output: the model's on `observation`, [1, ...].
          observation: of zeros, [1, ...].
          action: of zeros, [1, ...].
        """
        del key, output, observation, action
        return {}

    @abstractmethod
    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the scalar to minimise and named scalars to log.

        `output` is that of the parameters being trained, [T, B, ...]. Means are to be taken with
        `batch.mean`, so that the loss is that of the global batch on any number of devices. One
        entry of the named may be `PRIORITY`, float32 [B].
        """


def check_actor(loss: Loss, output: ActorCriticOutput) -> None:
    """Refuses models that have no policy of their own, for losses that teach one.

    Raises:
      JaxactError: the model's actions are the greedy ones of values.
    """
    if isinstance(output.distribution, EpsilonGreedy):
        raise JaxactError(
            f"{type(loss).__name__} learns a policy, but the model's actions are the greedy "
            "ones of values: use a model with an actor, such as ActorCritic, or DQN or PQN"
        )


@runtime_checkable
class Following(Protocol):
    """A loss with variables that follow what is trained, such as target networks."""

    def follow(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Returns the loss's variables after a gradient step.

        Args:
          variables: of the loss; before training, as `init` returns them, to be completed.
          params: of the model.
        """
        ...


@runtime_checkable
class Rewarding(Protocol):
    """A loss that adds a component to the reward, under its own name (curiosity, imitation)."""

    def reward(
        self, variables: dict[str, PyTree], trajectory: Any, axis_name: str | None
    ) -> tuple[jax.Array, dict[str, PyTree]]:
        """Judges a rollout before advantages are computed.

        Args:
          variables: of the loss.
          trajectory: a `jaxact.rollout.Trajectory`, [T, B, ...], with its own rewards.
          axis_name: the device axis to average statistics over, None on a single device.

        Returns:
          float32 [T, B], and the variables with what was learnt of the rollout's statistics.
        """
        ...


@runtime_checkable
class Anchored(Protocol):
    """A loss that looks back at the policy as it was when the stage began."""

    def anchor(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Returns the loss's variables at the beginning of a stage, of the same structure.

        Args:
          variables: of the loss.
          params: of the model, as they then are.
        """
        ...
