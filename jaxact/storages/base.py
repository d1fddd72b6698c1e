"""What every storage offers: batches that do not come from the stage's own rollout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError, unknown
from jaxact.frozen import FrozenMapping
from jaxact.losses.base import Batch, Loss, Unknown
from jaxact.pomdp import POMDP, PyTree
from jaxact.rollout import Trajectory
from jaxact.schedules import Schedule


@dataclass(frozen=True, kw_only=True)
class Storage(ABC):
    """Losses of a stage that are taken on other batches than the rollout, after each rollout.

    Each method sees the share of one device: its lanes, and its part of the state.

    A storage of one name in several stages is one storage: what it holds goes on.

    Attributes:
      losses: named losses, all on one forward pass of the model.
      weights: weight of each named loss (default 1); numbers or schedules of the stage's steps.
      updates: gradient steps after each rollout, each on a new batch.
      lanes: sequences side by side in a batch, over all devices.
      length: steps of each.
      keeps: names of fields of `Batch` that its batches have, of those that not all have.
    """

    keeps: ClassVar[frozenset[str]] = frozenset({"reward"})

    losses: Mapping[str, Loss]
    weights: Mapping[str, float | Schedule] = field(default_factory=dict)
    updates: int = 1
    lanes: int = 64
    length: int = 32

    def __post_init__(self) -> None:
        if not self.losses:
            raise JaxactError("a storage needs at least one loss to be of use")
        for name, loss in self.losses.items():
            if loss.needs_rollout:
                raise JaxactError(
                    f"{type(loss).__name__} ({name!r}) learns from what the policy has just done, "
                    f"and cannot be among the losses of a {type(self).__name__}"
                )
            needs = loss.needs | ({"expert"} if loss.needs_expert else set())
            for field_name in sorted(needs - self.keeps):
                others = [x.__name__ for x in _kinds(Storage) if field_name in x.keeps]
                raise JaxactError(
                    f"{type(loss).__name__} ({name!r}) needs {field_name!r}, which a "
                    f"{type(self).__name__} does not keep; the stage's own rollout has it"
                    + "".join(f", and a {other}" for other in others)
                )
        for name in self.weights:
            if name not in self.losses:
                raise unknown("loss in a storage's weights", name, self.losses)
        for name in ("losses", "weights"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))

    @property
    def acts(self) -> bool:
        """Whether it takes rollouts in, so that there must be some; by default, whether `add` is
        overridden.
        """
        return type(self).add is not Storage.add

    @property
    def steps(self) -> int:
        """Steps seen in each update of the stage."""
        return self.updates * self.lanes * self.length

    def load(self, pomdp: POMDP) -> PyTree:
        """Returns arrays that compiled programs take as an argument; by default none.

        Raises:
          JaxactError: they are of another world.
        """
        del pomdp
        return ()

    def width(self, lanes: int) -> int:
        """Returns the size of the state's leading axis; by default the lanes of a batch.

        Args:
          lanes: worlds stepped side by side.

        Raises:
          JaxactError: the storage does not work with that many.
        """
        del lanes
        return self.lanes

    @abstractmethod
    def init(self, pomdp: POMDP, model: Any, keys: jax.Array, data: PyTree) -> PyTree:
        """Returns the storage's first state, with a leading axis of lanes everywhere.

        Args:
          pomdp: the world.
          model: has `initial_memory(lanes)`.
          keys: a PRNG key for each entry of the leading axis, [width].
          data: from `load`.
        """

    def add(self, state: PyTree, trajectory: Trajectory, memory: PyTree) -> PyTree:
        """Takes in what was done in a rollout; returns the state with it, by default unchanged.

        Args:
          state: of the storage.
          trajectory: of the rollout, [T, B, ...].
          memory: the model's before the rollout, [B, ...].
        """
        del trajectory, memory
        return state

    def interrupt(self, state: PyTree, interrupted: jax.Array) -> PyTree:
        """Hears, before `add`, whether there were rollouts that it was not given since the last
        one; returns the state with a break there, by default unchanged.

        Args:
          state: of the storage.
          interrupted: bool scalar.
        """
        del interrupted
        return state

    def ready(self, state: PyTree, axis_name: str | None) -> jax.Array:
        """Returns a bool scalar: whether there is enough to learn from; by default always."""
        del state, axis_name
        return jnp.bool_(True)

    @abstractmethod
    def batch(self, state: PyTree, data: PyTree, axis_name: str | None) -> tuple[PyTree, Batch]:
        """Returns the next batch, [length, lanes], and the state after it."""

    @abstractmethod
    def carry_on(self, state: PyTree, memory: PyTree) -> PyTree:
        """Takes the model's memory [lanes, ...] after the batch; returns the state with it."""

    def reprioritize(self, state: PyTree, priority: jax.Array) -> PyTree:
        """Takes how much there is to learn from the sequences of the last batch, as the losses
        tell, float32 [lanes]; returns the state with it, by default unchanged.
        """
        del priority
        return state

    def not_kept(self, name: str) -> Any:
        """Returns what stands in a batch for a field that is not kept."""
        return Unknown(f"a loss asks for {name!r}, which a {type(self).__name__} does not keep")


def _kinds(kind: Any) -> list[Any]:
    """Returns a class and all that are derived from it."""
    return [kind, *(one for derived in kind.__subclasses__() for one in _kinds(derived))]
