"""Experience replay: what was done in past rollouts, sampled again as sequences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, BurnIn
from jaxact.pomdp import POMDP, PyTree
from jaxact.rollout import Trajectory, select
from jaxact.storages.base import Storage


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transitions:
    """Steps that were taken; leading axes are [lane, place in its ring].

    Attributes:
      observation, previous_action, is_first, action, log_prob, reward, reward_terms, terminated,
      truncated: as in `Batch`, but that the terms are only those of the world.
    """

    observation: dict[str, jax.Array]
    previous_action: PyTree
    is_first: jax.Array
    action: PyTree
    log_prob: jax.Array
    reward: jax.Array
    reward_terms: dict[str, jax.Array]
    terminated: jax.Array
    truncated: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rings:
    """What a replay holds; R lanes, each with a ring of `capacity` steps.

    Step n of a lane is in place n modulo the capacity.

    Attributes:
      key: PRNG key [R].
      taken: int32 [R], steps taken in so far; the same number for all lanes.
      steps: [R, capacity].
      memory: the model's before every `stride`-th step, [R, capacity / stride, ...].
    """

    key: jax.Array
    taken: jax.Array
    steps: Transitions
    memory: PyTree


@dataclass(frozen=True, kw_only=True)
class Replay(Storage):
    """The last steps of every lane; batches are sequences drawn from them uniformly.

    A sequence is `burn_in` steps that only warm the model's memory up, and `length` steps to learn
    from, of one lane and in the order in which they were taken, over ends of episodes too. It
    begins at every `stride`-th step, with the memory that the model had there when it acted
    (Kapturowski et al. 2019, "stored state with burn-in").

    Each lane of a batch draws from rings of its own, as many for each: so the rings and the draws
    are the same on any number of devices. What is held in the rings is part of the train state.

    The observation at which an episode ended is not kept, only the next one's first. So nothing is
    known of what the step before a truncation led to, and losses leave such steps out; to take them
    for terminal would be wrong.

    Where stages in between had rollouts without the replay, what it holds breaks off as by a
    truncation, and what comes after begins as an episode does.

    Attributes:
      capacity: steps held of each lane.
      burn_in: steps before those to learn from.
      stride: steps between the beginnings of sequences.
      start_after: steps, over all lanes, to be taken before learning begins.
    """

    keeps: ClassVar[frozenset[str]] = frozenset({"reward", "log_prob"})

    capacity: int
    burn_in: int = 0
    stride: int = 1
    start_after: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.burn_in < 0 or self.stride < 1 or self.capacity % self.stride:
            raise JaxactError(
                "a replay's burn_in must be at least 0, its stride at least 1 and a divisor of its "
                f"capacity; they are {self.burn_in}, {self.stride} and {self.capacity}"
            )
        if self.capacity < self.window + self.stride:
            raise JaxactError(
                f"a replay of sequences of {self.window} steps, with burn-in, that begin every "
                f"{self.stride} cannot do with a capacity of {self.capacity}; the least is "
                f"{-(-(self.window + self.stride) // self.stride) * self.stride}"
            )

    @property
    def window(self) -> int:
        """Steps of a sequence, with those of the burn-in."""
        return self.burn_in + self.length

    def width(self, lanes: int) -> int:
        """Returns the number of rings: one for each lane of the rollout."""
        if lanes % self.lanes and self.lanes % lanes:
            raise JaxactError(
                f"batches of {self.lanes} lanes cannot be drawn evenly from {lanes}; make one "
                "number a multiple of the other"
            )
        return lanes

    def init(self, pomdp: POMDP, model: Any, keys: jax.Array, data: PyTree) -> Rings:
        """Returns empty rings."""
        del data
        rings, action = keys.shape[0], pomdp.action_space.structure
        state, _ = jax.eval_shape(pomdp.reset, keys[0])
        _, step = jax.eval_shape(pomdp.step, keys[0], state, action)
        scalar, flag = jnp.float32(0), jnp.bool_(False)
        one = Transitions(
            observation=step.observation,
            previous_action=action,
            is_first=flag,
            action=action,
            log_prob=scalar,
            reward=scalar,
            reward_terms=dict(step.reward_terms),
            terminated=flag,
            truncated=flag,
        )
        slots = self.capacity // self.stride
        return Rings(
            key=keys,
            taken=jnp.zeros(rings, jnp.int32),
            steps=jax.tree.map(lambda x: jnp.zeros((rings, self.capacity, *x.shape), x.dtype), one),
            memory=jax.tree.map(
                lambda x: jnp.zeros((rings, slots, *x.shape[1:]), x.dtype),
                model.initial_memory(rings),
            ),
        )

    def add(self, state: Rings, trajectory: Trajectory, memory: PyTree) -> Rings:
        """Takes in a rollout, in place of what was held longest."""
        step = trajectory.step
        length = step.reward.shape[0]
        if length > self.capacity:
            raise JaxactError(
                f"a replay of {self.capacity} steps of each lane cannot hold a rollout of {length}"
            )
        last = (state.taken[0] - 1) % self.capacity
        ended = state.steps.terminated[:, last] | state.steps.truncated[:, last]
        broken = ended & ~trajectory.is_first[0]
        new = Transitions(
            observation=trajectory.observation,
            previous_action=jax.tree.map(
                lambda x: x.at[0].set(select(broken, jnp.zeros_like(x[0]), x[0])),
                trajectory.previous_action,
            ),
            is_first=trajectory.is_first.at[0].set(trajectory.is_first[0] | broken),
            action=trajectory.action,
            log_prob=trajectory.log_prob,
            reward=step.reward,
            reward_terms={name: step.reward_terms[name] for name in state.steps.reward_terms},
            terminated=step.terminated,
            truncated=step.truncated,
        )
        places = (state.taken[0] + jnp.arange(length, dtype=jnp.int32)) % self.capacity
        steps = jax.tree.map(
            lambda ring, x: ring.at[:, places].set(jnp.moveaxis(x, 0, 1), unique_indices=True),
            state.steps,
            new,
        )
        rows, slots = self._begun(state, length)

        def keep(ring: jax.Array, first: jax.Array, after: jax.Array) -> jax.Array:
            before = jnp.concatenate([first[None], after[:-1]])[rows]
            return ring.at[:, slots].set(jnp.moveaxis(before, 0, 1), mode="drop")

        kept = jax.tree.map(keep, state.memory, memory, trajectory.memory)
        return replace(state, taken=state.taken + length, steps=steps, memory=kept)

    def interrupt(self, state: PyTree, interrupted: jax.Array) -> Rings:
        """Returns rings whose last step is truncated if it was not the end of its episode."""
        last = (state.taken[0] - 1) % self.capacity
        steps = state.steps
        cut = steps.truncated[:, last] | (interrupted & ~steps.terminated[:, last])
        truncated = steps.truncated.at[:, last].set(cut)
        return replace(state, steps=replace(steps, truncated=truncated))

    def ready(self, state: Rings, axis_name: str | None) -> jax.Array:
        """Returns whether `start_after` steps were taken, and there is a sequence to draw."""
        _, count = self._beginnings(state)
        rings = state.taken.shape[0] * _devices(axis_name)
        # In float32, which does not overflow: the threshold need not be met to the step.
        enough = state.taken[0].astype(jnp.float32) * rings >= self.start_after
        return enough & (count > 0)

    def batch(self, state: Rings, data: PyTree, axis_name: str | None) -> tuple[Rings, Batch]:
        """Returns sequences drawn uniformly from those held."""
        del data
        state, lanes, pick, keys = self._deal(state, axis_name)
        first, count = self._beginnings(state)

        def draw(lane: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
            of_lane, of_slot = jax.random.split(key)
            ring = jax.random.randint(of_lane, (), 0, lanes.shape[1], jnp.int32)
            slot = jax.random.randint(of_slot, (), 0, jnp.maximum(count, 1), jnp.int32)
            return lane[ring], first + slot

        ring, slot = jax.vmap(draw)(lanes, pick)
        return state, self._sequences(state, ring, slot, keys, axis_name)

    def carry_on(self, state: PyTree, memory: PyTree) -> PyTree:
        """Returns the state: sequences do not go on in the next batch."""
        del memory
        return state

    @property
    def _slots(self) -> int:
        return self.capacity // self.stride

    def _begun(self, state: Rings, length: int) -> tuple[jax.Array, jax.Array]:
        """Finds at which of the next `length` steps sequences may begin.

        Returns:
          Their rows, int32 [N], and their slots in the ring; some at the end may be too many, and
          have a slot that there is not.
        """
        taken = state.taken[0]
        first = -taken % self.stride
        rows = first + self.stride * jnp.arange(-(-length // self.stride), dtype=jnp.int32)
        slots = (taken + rows) // self.stride % self._slots
        slots = jnp.where(rows < length, slots, self._slots)
        return jnp.minimum(rows, length - 1), slots

    def _beginnings(self, state: Rings) -> tuple[jax.Array, jax.Array]:
        """Returns the first sequence wholly held, as its beginning over the stride, and how many
        there are; int32 scalars.
        """
        taken = state.taken[0]
        oldest = taken - jnp.minimum(taken, self.capacity)
        first = -(-oldest // self.stride)
        return first, jnp.maximum((taken - self.window) // self.stride - first + 1, 0)

    def _deal(
        self, state: Rings, axis_name: str | None
    ) -> tuple[Rings, jax.Array, jax.Array, jax.Array]:
        """Deals rings and keys to the lanes of a batch.

        Returns:
          The state with other keys; the rings that each lane draws from, int32 [B, N]; and two PRNG
          keys for each lane, [B] and [B].
        """
        rings, lanes = state.taken.shape[0], self.lanes // _devices(axis_name)
        groups = min(rings, lanes)
        dealt = jnp.arange(rings, dtype=jnp.int32).reshape(groups, -1)
        keys, draws = jnp.moveaxis(jax.vmap(jax.random.split)(state.key), 1, 0)
        of_group = draws.reshape(groups, -1)[:, 0]
        split = jax.vmap(lambda key: jax.random.split(key, (lanes // groups, 2)))(of_group)
        pick, rest = jnp.moveaxis(split.reshape(lanes, 2), 1, 0)
        return replace(state, key=keys), jnp.repeat(dealt, lanes // groups, axis=0), pick, rest

    def _sequences(
        self, state: Rings, ring: jax.Array, slot: jax.Array, keys: jax.Array, axis_name: str | None
    ) -> Batch:
        """Returns the sequences of rings [B] that begin at slots [B] (of any turn), [length, B]."""
        slot = slot % self._slots
        rows = slot[None] * self.stride + jnp.arange(self.window, dtype=jnp.int32)[:, None]
        held = jax.tree.map(lambda x: x[ring[None], rows % self.capacity], state.steps)
        early, late = (
            jax.tree.map(lambda x, part=part: x[part], held)
            for part in (slice(self.burn_in), slice(self.burn_in, None))
        )
        burn_in = None
        if self.burn_in:
            burn_in = BurnIn(early.observation, early.previous_action, early.is_first)
        return Batch(
            observation=late.observation,
            previous_action=late.previous_action,
            is_first=late.is_first,
            memory=jax.tree.map(lambda x: x[ring, slot], state.memory),
            action=late.action,
            log_prob=late.log_prob,
            value=self.not_kept("value"),
            reward=late.reward,
            reward_terms=late.reward_terms,
            terminated=late.terminated,
            truncated=late.truncated,
            advantage=self.not_kept("advantage"),
            normalized_advantage=self.not_kept("normalized_advantage"),
            returns=self.not_kept("returns"),
            expert=None,
            key=keys,
            axis_name=axis_name,
            burn_in=burn_in,
        )


def _devices(axis_name: str | None) -> int:
    return 1 if axis_name is None else jax.lax.axis_size(axis_name)
