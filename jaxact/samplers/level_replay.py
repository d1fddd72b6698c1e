"""Prioritized level replay: the levels that there is most to learn from are played again."""

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
class LevelBuffer:
    """The levels that may be replayed, [N].

    Attributes:
      seed: uint32 [N].
      score: float32 [N], −inf where there is no level yet.
      played_at: int32 [N], the count of episodes when the level was last played.
      episodes: int32 scalar, episodes that have ended.
      inner: the state of the levels' sampler.
    """

    seed: jax.Array
    score: jax.Array
    played_at: jax.Array
    episodes: jax.Array
    inner: PyTree

    @property
    def holds(self) -> jax.Array:
        """Bool [N], where there is a level."""
        return jnp.isfinite(self.score)


@dataclass(frozen=True)
class PrioritizedLevelReplay(TaskSampler):
    """Replays levels of another sampler, those with the greatest value errors first.

    A level is a seed: the episode that `sampler` draws, in its first state, with
    `make_key(seed)`. An episode replays a level with probability `replay`, as soon as there is any,
    and else is a new one. A level is replayed with probability (1 − ρ) P_S + ρ P_C, where P_S is in
    proportion to rank^(−1/β), the highest score having rank 1, and P_C to the number of episodes
    since the level was last played (equations 2 to 4 of the paper).

    A level's score is its latest L1 value loss, mean |advantage|. Once a rollout, all levels that
    were finished in it are scored anew: over those steps of the episode that were taken in this
    rollout, and if it was played more than once, by the mean. New levels take the free
    places, the best first; when there are none, those of the least probable levels with a lower
    score. Staleness counts episodes when they end, where the paper counts them when they begin.

    Source: Jiang et al. 2021, "Prioritized Level Replay" (https://arxiv.org/abs/2010.03934). The
    buffer of a fixed size for an endless supply of levels is that of Jiang et al. 2021b
    (https://arxiv.org/abs/2110.02439). Evaluation is on new levels only.

    Attributes:
      sampler: whose levels they are; it does not learn.
      size: N, levels kept.
      replay: the probability of replaying one.
      temperature: β > 0; small values prefer the highest scores, large ones prefer none.
      staleness: ρ, how much levels played long ago are preferred.

    Raises:
      JaxactError: a number out of its bounds.
    """

    sampler: TaskSampler
    size: int = 4000
    replay: float = 0.5
    temperature: float = 0.1
    staleness: float = 0.1

    def __post_init__(self) -> None:
        if self.size < 1:
            raise JaxactError(f"size must be at least 1, got {self.size}")
        if self.temperature <= 0:
            raise JaxactError(f"temperature must be positive, got {self.temperature}")
        for name in ("replay", "staleness"):
            if not 0 <= getattr(self, name) <= 1:
                raise JaxactError(f"{name} must be in 0 … 1, got {getattr(self, name)}")

    @property
    def held_out(self) -> TaskSampler:
        """The sampler of the levels."""
        return self.sampler.held_out

    def init(self, key: jax.Array) -> LevelBuffer:
        """Returns an empty buffer, the same for every key."""
        del key
        return LevelBuffer(
            seed=jnp.zeros(self.size, jnp.uint32),
            score=jnp.full(self.size, -jnp.inf, jnp.float32),
            played_at=jnp.zeros(self.size, jnp.int32),
            episodes=jnp.int32(0),
            inner=self.sampler.init(make_key(0)),
        )

    def sample(self, key: jax.Array, sampler_state: LevelBuffer) -> Episode:
        """Draws one episode: a level of the buffer, or a new one."""
        replay_key, level_key, seed_key = jax.random.split(key, 3)
        uniform = jax.random.uniform(replay_key, (), jnp.float32)
        is_new = (uniform >= self.replay) | ~jnp.any(sampler_state.holds)
        bounds = jnp.cumsum(self.probabilities(sampler_state))
        point = jax.random.uniform(level_key, (), jnp.float32) * bounds[-1]
        # Never beyond the last level, where rounding might lead; empty places have no width.
        last = jnp.searchsorted(bounds, bounds[-1])
        index = jnp.minimum(jnp.searchsorted(bounds, point, side="right"), last)
        known = sampler_state.seed[index]
        return sample_level(self.sampler, sampler_state.inner, seed_key, known, is_new)

    def probabilities(self, buffer: LevelBuffer) -> jax.Array:
        """Returns how likely each level is when one is replayed, float32 [N]; 0 for no level."""
        holds = buffer.holds
        rank = jnp.argsort(jnp.argsort(-buffer.score)).astype(jnp.float32) + 1
        by_score = jnp.where(holds, rank ** (-1 / jnp.asarray(self.temperature, jnp.float32)), 0.0)
        age = jnp.where(holds, buffer.episodes - buffer.played_at, 0).astype(jnp.float32)
        by_score = by_score / jnp.maximum(jnp.sum(by_score), 1e-30)
        # Where all were played just now, none is stale.
        by_age = jnp.where(jnp.sum(age) > 0, age / jnp.maximum(jnp.sum(age), 1.0), by_score)
        return (1 - self.staleness) * by_score + self.staleness * by_age

    def update(self, sampler_state: LevelBuffer, finished: FinishedEpisodes) -> LevelBuffer:
        """Scores the levels that were finished, and takes in new ones."""
        mask, origin = finished.mask.reshape(-1), finished.origin
        seed, is_new = origin.seed.reshape(-1), origin.is_new.reshape(-1)
        assert finished.mean_error is not None
        score = finished.mean_error.reshape(-1)
        buffer = self._rescore(sampler_state, mask, seed, score)
        return self._admit(buffer, mask & is_new, seed, score)

    def _rescore(
        self, buffer: LevelBuffer, mask: jax.Array, seed: jax.Array, score: jax.Array
    ) -> LevelBuffer:
        """Replaces the scores of levels that are in the buffer; episodes are [M]."""
        place = jnp.where(mask, place_of(buffer.seed, buffer.holds, seed), self.size)
        zeros = jnp.zeros(self.size, jnp.float32)
        total = zeros.at[place].add(score, mode="drop")
        times = zeros.at[place].add(1.0, mode="drop")
        episodes = buffer.episodes + jnp.sum(mask, dtype=jnp.int32)
        return LevelBuffer(
            seed=buffer.seed,
            score=jnp.where(times > 0, total / jnp.maximum(times, 1.0), buffer.score),
            played_at=jnp.where(times > 0, episodes, buffer.played_at),
            episodes=episodes,
            inner=buffer.inner,
        )

    def _admit(
        self, buffer: LevelBuffer, mask: jax.Array, seed: jax.Array, score: jax.Array
    ) -> LevelBuffer:
        """Gives new levels the places of none or of less; episodes are [M].

        No level is here twice: one drawn as new ends once, and what was replayed is not new.
        """
        count = min(self.size, mask.shape[0])
        best, rows = jax.lax.top_k(jnp.where(mask, score, -jnp.inf), count)
        # Empty places have probability 0, so they come first.
        places = jnp.argsort(self.probabilities(buffer))[:count]
        places = jnp.where(best > buffer.score[places], places, self.size)
        return LevelBuffer(
            seed=buffer.seed.at[places].set(seed[rows], mode="drop"),
            score=buffer.score.at[places].set(best, mode="drop"),
            played_at=buffer.played_at.at[places].set(buffer.episodes, mode="drop"),
            episodes=buffer.episodes,
            inner=buffer.inner,
        )

    def kinds(self, origin: LevelOrigin) -> Mapping[str, jax.Array]:
        """Those of the sampler."""
        return self.sampler.kinds(origin.inner)

    def metrics(self, sampler_state: LevelBuffer) -> dict[str, jax.Array]:
        """How many levels the buffer holds, and their mean score."""
        holds = sampler_state.holds
        levels = jnp.sum(holds.astype(jnp.float32))
        total = jnp.sum(jnp.where(holds, sampler_state.score, 0.0))
        return {"levels": levels, "score": total / jnp.maximum(levels, 1.0)}
