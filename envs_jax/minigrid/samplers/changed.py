"""The episodes of another sampler, each changed before it begins."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax

from jaxact.errors import JaxactError
from jaxact.pomdp import Episode, PyTree, TaskSampler


@dataclass(frozen=True)
class ChangedEpisodes(TaskSampler):
    """What samplers share that change the episodes of another one.

    Attributes:
      sampler: whose episodes they are; it does not learn.

    Raises:
      JaxactError: the sampler learns: what it learns from episodes would not reach it.
    """

    sampler: TaskSampler

    def __post_init__(self) -> None:
        if self.sampler.learns:
            name = type(self.sampler).__name__
            raise JaxactError(f"{name} learns: change the worlds of its parts, not the whole")

    @property
    def held_out(self) -> TaskSampler:
        """The held-out episodes of the sampler, changed."""
        return replace(self, sampler=self.sampler.held_out)

    def init(self, key: jax.Array) -> PyTree:
        """Returns the first state of the sampler."""
        return self.sampler.init(key)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        return self.change(self.sampler.sample(key, sampler_state))

    def kinds(self, origin: PyTree) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.kinds(origin)

    @abstractmethod
    def change(self, episode: Episode) -> Episode:
        """Returns the episode as it is to be played."""
