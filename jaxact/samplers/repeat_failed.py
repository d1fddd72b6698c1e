"""Levels that were failed are given again, for some time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.pomdp import Episode, FinishedEpisodes, PyTree, TaskSampler
from jaxact.samplers.levels import LevelOrigin, place_of, sample_level
from jaxact.train_state import make_key


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WaitingLevels:
    """The levels that are to be given again, in the first places of [N].

    Attributes:
      seed: uint32 [N].
      steps: int32 [N], spent on each so far.
      count: int32 scalar, how many there are.
      played: int32 scalar, how many episodes there were in the latest rollout to give them to: as
        many as ended in it, and at least one for each lane.
      inner: the state of the levels' sampler.
    """

    seed: jax.Array
    steps: jax.Array
    count: jax.Array
    played: jax.Array
    inner: PyTree

    @property
    def holds(self) -> jax.Array:
        """Bool [N], where there is a level."""
        return jnp.arange(self.seed.shape[0], dtype=jnp.int32) < self.count

    @property
    def share(self) -> jax.Array:
        """float32 scalar, the probability that an episode is of one of these levels."""
        return jnp.minimum(self.count.astype(jnp.float32) / self.played.astype(jnp.float32), 1.0)


@dataclass(frozen=True)
class RepeatFailed(TaskSampler):
    """Gives failed levels of another sampler again, until they succeed or enough was spent on them.

    So that what is hard is not left after one short attempt, as where failing ends an episode at
    once (lava). If all levels fail, and after n steps each, about a share of 1 − n / `min_steps` of
    the episodes are repeats.

    A level is a seed: the episode that `sampler` draws, in its first state, with `make_key(seed)`.
    After an episode that failed, its level waits if fewer than `min_steps` steps were spent on it.
    Each level that waits is given again about once in each rollout, or, where episodes are longer
    than rollouts, in the course of an episode: an episode is one of them, each as likely, with the
    probability of how many wait to how many episodes ended in the latest rollout, or to the number
    of lanes if that is more, and else a new one.

    After AllenAct's `repeat_failed_task_for_min_steps`, with which the process that failed a task
    begins it again at once. Here many lanes share the sampler, which learns once a rollout what was
    failed in it. So the level waits until the next rollout, and any lane may take it on, in some
    rollouts none and in some several. All their steps count, so that a little more is spent on a
    level than AllenAct would. Episodes that are going on when another one succeeds are played to
    their end.

    The levels that wait, and the share of episodes that are of them, are reported as
    "train/sampler/waiting" and "train/sampler/share". Success in training is that of all episodes,
    repeats as well; evaluation is on new levels only.

    Attributes:
      sampler: whose levels they are; it does not learn.
      min_steps: how many steps are spent on a level before it is given up; the episode in which
        they are reached counts in full.
      size: N, the most levels that wait; as many as episodes end in a rollout are enough. Failed
        levels for which there is no place are given up.

    Raises:
      JaxactError: a number out of its bounds.
    """

    sampler: TaskSampler
    min_steps: float = 1000.0
    size: int = 4000

    def __post_init__(self) -> None:
        if self.size < 1:
            raise JaxactError(f"size must be at least 1, got {self.size}")
        if self.min_steps < 0:
            raise JaxactError(f"min_steps must not be negative, got {self.min_steps}")

    @property
    def held_out(self) -> TaskSampler:
        """The sampler of the levels."""
        return self.sampler.held_out

    def init(self, key: jax.Array) -> WaitingLevels:
        """Returns that no level waits, the same for every key."""
        del key
        return WaitingLevels(
            seed=jnp.zeros(self.size, jnp.uint32),
            steps=jnp.zeros(self.size, jnp.int32),
            count=jnp.int32(0),
            played=jnp.int32(1),
            inner=self.sampler.init(make_key(0)),
        )

    def sample(self, key: jax.Array, sampler_state: WaitingLevels) -> Episode:
        """Draws one episode: a level that waits, or a new one."""
        repeat_key, level_key, seed_key = jax.random.split(key, 3)
        is_new = jax.random.uniform(repeat_key, (), jnp.float32) >= sampler_state.share
        count = jnp.maximum(sampler_state.count, 1)
        known = sampler_state.seed[jax.random.randint(level_key, (), 0, count, jnp.int32)]
        return sample_level(self.sampler, sampler_state.inner, seed_key, known, is_new)

    def update(self, sampler_state: WaitingLevels, finished: FinishedEpisodes) -> WaitingLevels:
        """Counts the steps spent, lets go of levels, and takes in those that were failed."""
        origin: LevelOrigin = finished.origin
        mask, success, length, seed, is_new = (
            x.reshape(-1)
            for x in (finished.mask, finished.success, finished.length, origin.seed, origin.is_new)
        )
        holds = sampler_state.holds
        place = place_of(sampler_state.seed, holds, seed)
        place = jnp.where(mask & ~is_new, place, self.size)
        spent = sampler_state.steps.at[place].add(length, mode="drop")
        done = jnp.where(success, place, self.size)
        waits = holds.at[done].set(False, mode="drop")

        # A new level ends once, so none is here twice. Those that waited before keep their turn.
        seeds = jnp.concatenate([sampler_state.seed, seed])
        steps = jnp.concatenate([spent, length])
        stays = jnp.concatenate([waits, mask & is_new & ~success])
        stays &= steps.astype(jnp.float32) < self.min_steps
        places = jnp.where(stays, jnp.cumsum(stays, dtype=jnp.int32) - 1, self.size)
        ended, lanes = jnp.sum(mask, dtype=jnp.int32), finished.mask.shape[1]
        return WaitingLevels(
            seed=jnp.zeros(self.size, jnp.uint32).at[places].set(seeds, mode="drop"),
            steps=jnp.zeros(self.size, jnp.int32).at[places].set(steps, mode="drop"),
            count=jnp.minimum(jnp.sum(stays, dtype=jnp.int32), self.size),
            played=jnp.maximum(ended, lanes),
            inner=sampler_state.inner,
        )

    def kinds(self, origin: LevelOrigin) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.kinds(origin.inner)

    def metrics(self, sampler_state: WaitingLevels) -> dict[str, jax.Array]:
        """How many levels wait, and the share of episodes that are of them."""
        return {
            "waiting": sampler_state.count.astype(jnp.float32),
            "share": sampler_state.share,
        }
