"""Temporal distance: how many steps lie between two observations of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import check_at_least
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.windows import at_last, first_and_last, named_features, uniform
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree


@dataclass(frozen=True, kw_only=True)
class TemporalDistance(Loss):
    """½ ((d(φ_i, φ_j, b) − (j − i)) / n)² on random pairs of steps of an episode (Ye et al. 2020,
    https://arxiv.org/abs/2007.04561).

    d is linear, φ the encoder's embedding, b the belief at the episode's last step in the window
    and n the number of steps from its first to its last one there, as in AllenAct. Each episode in
    a window counts alike.

    Being linear in the embeddings, d can tell no more than where observations themselves show
    progress: something that grows from step to step, such as the place of who walks on, a clock, or
    what has been done. The belief is one for all pairs of an episode, and so can only move all
    distances together. Where observations come and go, as to an agent that looks about in a room
    (GoToLocal), the loss stays at what d = 0 gives, about 1/12.

    Attributes:
      pairs: how many pairs are drawn of each episode; i and j are drawn apart, in any order.
      longer_than: episodes count if their n in the window is greater.
      belief: name of the belief in the model's extras.
    """

    pairs: int = 8
    longer_than: int = 5
    belief: str = "belief"

    def __post_init__(self) -> None:
        check_at_least(1, "TemporalDistance", pairs=self.pairs)

    @property
    def least_length(self) -> int:
        """Of an episode with more than `longer_than` steps from first to last."""
        return self.longer_than + 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without the belief asked for."""
        named_features(output, self.belief)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the parameters of d."""
        del observation, action
        embedding, belief = output.extras["embedding"], named_features(output, self.belief)
        return dict(_LinearDistance().init(key, embedding, belief))

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the squared error, with error, the mean |d − (j − i)| in steps."""
        del progress
        first, last = first_and_last(batch.is_first)
        belief = at_last(named_features(output, self.belief), batch.is_first)
        summands: Any = _LinearDistance().apply(variables, output.extras["embedding"], belief)
        of_first, of_second, of_belief = summands
        # Each episode's pairs are drawn at its last step, where `last` is the step itself.
        span = last - first
        draws = uniform(batch, self.pairs, 2)
        chosen = jnp.floor(draws * (span + 1)[..., None, None].astype(jnp.float32))
        chosen = jnp.minimum(chosen.astype(jnp.int32), span[..., None, None])
        i, j = jnp.moveaxis(chosen + first[..., None, None], -1, 0)

        guess = _pick(of_first, i) + _pick(of_second, j) + of_belief[..., None]
        error = guess - (j - i).astype(jnp.float32)
        time = jnp.arange(last.shape[0], dtype=jnp.int32)[:, None]
        counts = (last == time) & (span > self.longer_than)
        scaled = error / jnp.maximum(span, 1)[..., None].astype(jnp.float32)
        loss = batch.mean(jnp.mean(0.5 * jnp.square(scaled), axis=-1), where=counts)
        return loss, {
            "squared_error": loss,
            "error": batch.mean(jnp.mean(jnp.abs(error), axis=-1), where=counts),
        }


class _LinearDistance(nn.Module):
    """The three summands of a linear function of two embeddings and a belief.

    Apart they are a number for each step, and pairs need not be laid out as vectors.
    """

    @nn.compact
    def __call__(
        self, embedding: jax.Array, belief: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Returns float32 [...] each."""
        of_pair = nn.Dense(2, use_bias=False, name="embedding")(embedding)
        of_belief = nn.Dense(1, name="belief")(belief)
        return of_pair[..., 0], of_pair[..., 1], of_belief[..., 0]


def _pick(values: jax.Array, index: jax.Array) -> jax.Array:
    """Returns values [T, B] at time indices [T, B, P] of the same lane."""
    return jnp.take_along_axis(values[..., None], index, axis=0)
