"""Prioritised replay: sequences of which more is to be learnt are drawn more often."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch
from jaxact.pomdp import POMDP, PyTree
from jaxact.rollout import Trajectory
from jaxact.storages.replay import Replay, Rings


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PrioritizedRings(Rings):
    """Rings with what their sequences are worth.

    Attributes:
      priority: p^α of each sequence, by its beginning, float32 [R, capacity / stride].
      drawn: int32 [lanes of a batch, 2], ring and slot of the last batch's sequences.
    """

    priority: jax.Array
    drawn: jax.Array


@dataclass(frozen=True, kw_only=True)
class PrioritizedReplay(Replay):
    """Proportional prioritisation (Schaul et al. 2016, https://arxiv.org/abs/1511.05952).

    Of the sequences in a lane's rings, one is drawn with probability P = p^α / Σ p^α, where p is
    what the losses last told of it under `PRIORITY`, and counts (1 / P)^β in the losses, over the
    greatest such weight in the batch. A new sequence has the highest priority of its ring, so that
    each is soon learnt from. (A sum over the rings in each draw, rather than a tree of sums: it
    costs a pass over capacity / stride numbers a lane.)

    Attributes:
      alpha: α, 0 is uniform.
      beta: β, 1 makes up for the drawing in full.
    """

    alpha: float = 0.6
    beta: float = 0.4

    def init(self, pomdp: POMDP, model: Any, keys: jax.Array, data: PyTree) -> PrioritizedRings:
        """Returns empty rings."""
        rings = super().init(pomdp, model, keys, data)
        return PrioritizedRings(
            **vars(rings),
            priority=jnp.zeros((keys.shape[0], self._slots), jnp.float32),
            drawn=jnp.zeros((self.lanes, 2), jnp.int32),
        )

    def add(self, state: PyTree, trajectory: Trajectory, memory: PyTree) -> Rings:
        """Takes in a rollout, in place of what was held longest."""
        _, slots = self._begun(state, trajectory.step.reward.shape[0])
        highest = jnp.max(state.priority, axis=1, keepdims=True)
        highest = jnp.where(highest > 0.0, highest, 1.0)
        new = jnp.broadcast_to(highest, (highest.shape[0], slots.shape[0]))
        priority = state.priority.at[:, slots].set(new, mode="drop")
        added: PyTree = super().add(state, trajectory, memory)
        return replace(added, priority=priority)

    def batch(self, state: PyTree, data: PyTree, axis_name: str | None) -> tuple[Rings, Batch]:
        """Returns sequences drawn by priority, with their weights."""
        del data
        dealt, lanes, pick, keys = self._deal(state, axis_name)
        # Lanes that draw from the same rings share their sum.
        groups = min(lanes.shape[0], state.taken.shape[0])
        held = jnp.where(self._wholly_held(state), state.priority, 0.0).reshape(groups, -1)
        sums = jnp.cumsum(held, axis=1)
        uniform = jax.vmap(lambda key: jax.random.uniform(key, (), jnp.float32))(pick)
        total = sums[:, -1:]
        # Below the last sum whatever the rounding, so that what is drawn has some priority.
        level = jnp.minimum(uniform.reshape(groups, -1) * total, jnp.nextafter(total, 0.0))
        index = jax.vmap(lambda s, x: jnp.searchsorted(s, x, side="right"))(sums, level)
        index = jnp.minimum(index, held.shape[1] - 1).astype(jnp.int32)
        probability = jnp.take_along_axis(held, index, axis=1) / jnp.maximum(total, 1e-30)
        ring = lanes[jnp.arange(len(lanes)), index.reshape(-1) // self._slots]
        slot = index.reshape(-1) % self._slots
        weight = jnp.power(jnp.maximum(probability.reshape(-1), 1e-30), -self.beta)
        greatest = jnp.max(weight)
        if axis_name is not None:
            greatest = jax.lax.pmax(greatest, axis_name)
        batch = self._sequences(state, ring, slot, keys, axis_name)
        state = replace(state, key=dealt.key, drawn=jnp.stack([ring, slot], axis=1))
        return state, replace(batch, weight=weight / greatest)

    def reprioritize(self, state: PyTree, priority: jax.Array) -> Rings:
        """Takes the absolute errors of the sequences of the last batch, float32 [lanes]."""
        ring, slot = state.drawn.T
        # While nothing is ready to be learnt from, what was drawn is no sequence.
        held = self._wholly_held(state)[slot]
        new = jnp.where(held, jnp.power(priority + 1e-6, self.alpha), state.priority[ring, slot])
        # The greater one of a sequence that was drawn twice: the order of writing has no say.
        cleared = state.priority.at[ring, slot].set(0.0)
        return replace(state, priority=cleared.at[ring, slot].max(new))

    def _wholly_held(self, state: Rings) -> jax.Array:
        """Returns which slots begin a sequence that is wholly held, bool [slots]."""
        first, count = self._beginnings(state)
        return (jnp.arange(self._slots, dtype=jnp.int32) - first) % self._slots < count
