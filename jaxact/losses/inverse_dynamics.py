"""Inverse dynamics: which action was taken between two observations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.windows import at_last, goes_on, later, named_features
from jaxact.models.heads import ActorHead
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.spaces import Space


@dataclass(frozen=True, kw_only=True)
class InverseDynamics(Loss):
    """Cross-entropy of a_t given [φ_t, φ_{t+1}, b], linear in these (Ye et al. 2020,
    https://arxiv.org/abs/2007.04561).

    φ is the encoder's embedding and b the belief at the episode's last step in the window, as in
    AllenAct. Steps after which the window or the episode ends do not count.

    Attributes:
      action_space: of the actions.
      belief: name of the belief in the model's extras.
    """

    action_space: Space
    belief: str = "belief"

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without the belief asked for."""
        named_features(output, self.belief)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the parameters of the linear layer."""
        del observation, action
        embedding = output.extras["embedding"]
        features = [embedding, embedding, named_features(output, self.belief)]
        return dict(ActorHead(self.action_space).init(key, jnp.concatenate(features, axis=-1)))

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the cross-entropy."""
        del progress
        embedding = output.extras["embedding"]
        belief = at_last(named_features(output, self.belief), batch.is_first)
        features = jnp.concatenate([embedding, later(embedding, 1), belief], axis=-1)
        guess: Any = ActorHead(self.action_space).apply(variables, features)
        cross_entropy = -batch.mean(guess.log_prob(batch.action), where=goes_on(batch.is_first, 1))
        return cross_entropy, {"cross_entropy": cross_entropy}
