"""What a model returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax

from jaxact.distributions import Distribution


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ActorCriticOutput:
    """Policy and value on a batch of observations.

    Attributes:
      distribution: over actions, [batch].
      value: float32 [batch], expected discounted return.
      extras: named arrays for losses that ask for more (beliefs, embeddings, auxiliary heads).
    """

    distribution: Distribution
    value: jax.Array
    extras: Mapping[str, Any] = field(default_factory=dict)
