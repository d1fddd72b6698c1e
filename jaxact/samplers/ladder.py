"""A curriculum whose difficulty follows success."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.frozen import FrozenMapping
from jaxact.pomdp import Episode, FinishedEpisodes, PyTree, TaskSampler
from jaxact.samplers.mixture import MixtureSampler
from jaxact.samplers.parts import (
    PartOrigin,
    draw_part,
    init_parts,
    kinds_of_parts,
    metrics_of_parts,
    update_parts,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LadderState:
    """Where a ladder stands.

    Attributes:
      rung: int32, the present rung, from 0.
      episodes: int32, episodes of this rung that ended in the present block.
      successes: int32, those that succeeded.
      rungs: the states of the rungs' samplers.
    """

    rung: jax.Array
    episodes: jax.Array
    successes: jax.Array
    rungs: tuple[PyTree, ...]


@dataclass(frozen=True)
class LadderSampler(TaskSampler):
    """Climbs from easy tasks to hard ones, a rung at a time, as each is mastered.

    Success on the present rung is measured in blocks of at least `episodes` episodes; after a block
    with a success rate of at least `promote_at` the next rung is the present one. There is no way
    down, but a share of the episodes rehearses lower rungs. Episodes that have begun are played to
    their end.

    Success is reported by the rungs' names, as by `MixtureSampler`, and the present rung as
    "train/sampler/rung". Evaluation plays all rungs in equal shares, at any time.

    Attributes:
      rungs: samplers by name, from the easiest to the hardest; their episodes must be of one
        structure, with the same shapes and dtypes.
      promote_at: the success rate that is to be reached.
      episodes: the least size of a block.
      rehearsal: the share of episodes that are of a lower rung, each as often, if there is one.

    Raises:
      JaxactError: no rungs, a rate or share outside of 0 … 1, or a block without episodes.
    """

    rungs: Mapping[str, TaskSampler]
    promote_at: float = 0.9
    episodes: int = 200
    rehearsal: float = 0.2

    def __post_init__(self) -> None:
        object.__setattr__(self, "rungs", FrozenMapping(self.rungs))
        if not self.rungs:
            raise JaxactError("a ladder needs at least one rung")
        for name in ("promote_at", "rehearsal"):
            if not 0 <= getattr(self, name) <= 1:
                raise JaxactError(f"{name} must be in 0 … 1, got {getattr(self, name)}")
        if self.episodes < 1:
            raise JaxactError(f"episodes must be at least 1, got {self.episodes}")

    @property
    def held_out(self) -> TaskSampler:
        """All rungs, in equal shares."""
        return MixtureSampler(self.rungs).held_out

    def init(self, key: jax.Array) -> LadderState:
        """Returns the lowest rung.

        Raises:
          JaxactError: the rungs' episodes differ in structure, shapes or dtypes.
        """
        return LadderState(jnp.int32(0), jnp.int32(0), jnp.int32(0), init_parts(self.rungs, key))

    def sample(self, key: jax.Array, sampler_state: LadderState) -> Episode:
        """Draws one episode, of the present rung or of a lower one."""
        rehearse_key, lower_key, draw_key = jax.random.split(key, 3)
        rung = sampler_state.rung
        rehearses = jax.random.uniform(rehearse_key, (), jnp.float32) < self.rehearsal
        lower = jax.random.randint(lower_key, (), 0, jnp.maximum(rung, 1), jnp.int32)
        chosen = jnp.where(rehearses, lower, rung)
        return draw_part(tuple(self.rungs.values()), chosen, draw_key, sampler_state.rungs)

    def update(self, sampler_state: LadderState, finished: FinishedEpisodes) -> LadderState:
        """Counts the episodes of the present rung, and climbs if its block is full and good."""
        present = finished.mask & (finished.origin.part == sampler_state.rung)
        episodes = sampler_state.episodes + jnp.sum(present, dtype=jnp.int32)
        successes = sampler_state.successes + jnp.sum(present & finished.success, dtype=jnp.int32)
        full = episodes >= self.episodes
        enough = successes.astype(jnp.float32) >= self.promote_at * episodes.astype(jnp.float32)
        climbed = sampler_state.rung + (full & enough).astype(jnp.int32)
        return replace(
            sampler_state,
            rung=jnp.minimum(climbed, len(self.rungs) - 1),
            episodes=jnp.where(full, 0, episodes),
            successes=jnp.where(full, 0, successes),
            rungs=update_parts(tuple(self.rungs.values()), sampler_state.rungs, finished),
        )

    def kinds(self, origin: PartOrigin) -> dict[str, jax.Array]:
        """One for each rung, by its name."""
        return kinds_of_parts(self.rungs, origin)

    def metrics(self, sampler_state: LadderState) -> dict[str, jax.Array]:
        """The present rung, and the metrics of the rungs under "rung's name/metric"."""
        rung = sampler_state.rung.astype(jnp.float32)
        return {"rung": rung, **metrics_of_parts(self.rungs, sampler_state.rungs)}
