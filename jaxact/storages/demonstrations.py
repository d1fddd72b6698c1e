"""Recorded demonstrations as a storage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxact.demonstration_windows import DemonstrationData, next_windows, start_cursor
from jaxact.demonstrations import Demonstrations
from jaxact.losses.base import Batch
from jaxact.pomdp import POMDP, PyTree
from jaxact.storages.base import Storage


@dataclass(frozen=True, kw_only=True)
class DemonstrationStorage(Storage):
    """Whole episodes recorded by `python -m jaxact.collect`, window after window.

    Each lane plays through one episode after the other, and the model's memory is carried from
    window to window; no episode begins a second time before all have begun. In its batches `expert`
    is what was done, not valid where the recorded expert abstained, with its whole policy if that
    was recorded. Their reward is that of the world, with the components weighed as `Stage.rewards`
    says; losses' own rewards are for rollouts.

    Attributes:
      path: the directory of the recording.
    """

    keeps: ClassVar[frozenset[str]] = frozenset({"reward", "expert"})

    path: str

    def load(self, pomdp: POMDP) -> DemonstrationData:
        """Returns the recorded arrays; see `Demonstrations.load`."""
        return Demonstrations(self.path).load(pomdp)

    def init(self, pomdp: POMDP, model: Any, keys: jax.Array, data: PyTree) -> PyTree:
        """Returns the place before the first window, with an empty memory."""
        del pomdp
        return {
            "cursor": start_cursor(data.episodes, self.lanes, keys[0]),
            "memory": model.initial_memory(self.lanes),
            "key": keys,
        }

    def batch(self, state: PyTree, data: PyTree, axis_name: str | None) -> tuple[PyTree, Batch]:
        """Returns the next window of every lane."""
        windows, cursor = next_windows(data, state["cursor"], self.length, axis_name)
        keys, draws = jnp.moveaxis(jax.vmap(jax.random.split)(state["key"]), 1, 0)
        batch = Batch(
            observation=windows.observation,
            previous_action=windows.previous_action,
            is_first=windows.is_first,
            memory=state["memory"],
            action=windows.expert.action,
            log_prob=self.not_kept("log_prob"),
            value=self.not_kept("value"),
            reward=windows.reward,
            reward_terms=windows.reward_terms,
            terminated=windows.terminated,
            truncated=windows.truncated,
            advantage=self.not_kept("advantage"),
            normalized_advantage=self.not_kept("normalized_advantage"),
            returns=self.not_kept("returns"),
            expert=windows.expert,
            key=draws,
            axis_name=axis_name,
        )
        return {**state, "cursor": cursor, "key": keys}, batch

    def carry_on(self, state: PyTree, memory: PyTree) -> PyTree:
        """Returns the state with the memory to begin the next window with."""
        return {**state, "memory": memory}
