"""Several recurrent memories side by side, fused into one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError, unknown


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Beliefs:
    """What a memory of several parts returns in the place of features.

    Attributes:
      fused: float32 [..., H], for the actor and the critic.
      named: float32 [..., H] each, the parts by name.
      weights: float32 [...] each, of the parts in the fusion; they sum to 1.
    """

    fused: jax.Array
    named: dict[str, jax.Array]
    weights: dict[str, jax.Array]


class MultipleBeliefs(nn.Module):
    """Memories on the same features, fused by weights (Ye et al. 2020,
    https://arxiv.org/abs/2007.04561).

    Each auxiliary loss can shape a belief of its own: the output's extras have every belief under
    its name, and under "fusion" the weights by the beliefs' names, for `FusionEntropy`.

    Attributes:
      memories: `GRU`, `LSTM` and the like by the belief's name, all of one size.
      fusion: how the weights come about. "attention": softmax of q(x) · b_i / √H, with a query q
        linear in the features x; "softmax": of scores linear in x; "average": all alike.
    """

    memories: Mapping[str, nn.Module]
    fusion: str = "attention"

    @nn.compact
    def __call__(
        self, inputs: jax.Array, memory: dict[str, Any], is_first: jax.Array
    ) -> tuple[Beliefs, dict[str, Any]]:
        """Returns the beliefs [T, B, H] (or [B, H]), and the memories after them.

        Raises:
          JaxactError: the memories differ in size, a name is taken, or there is no such fusion.
        """
        for name in ("belief", "embedding", "fusion", "auxiliary_distribution"):
            if name in self.memories:
                raise JaxactError(f"{name!r} cannot name one of several beliefs: the extras use it")
        named: dict[str, jax.Array] = {}
        after: dict[str, Any] = {}
        for name, part in self.memories.items():
            named[name], after[name] = part(inputs, memory[name], is_first)
        sizes = {name: belief.shape[-1] for name, belief in named.items()}
        if len(set(sizes.values())) > 1:
            raise JaxactError(f"beliefs to be fused must be of one size, but they are {sizes}")
        beliefs = jnp.stack(list(named.values()), axis=-2)
        weights = nn.softmax(self._scores(inputs, beliefs))
        fused = jnp.sum(weights[..., None] * beliefs, axis=-2)
        by_name = dict(zip(named, jnp.moveaxis(weights, -1, 0), strict=True))
        return Beliefs(fused, named, by_name), after

    def _scores(self, inputs: jax.Array, beliefs: jax.Array) -> jax.Array:
        """Returns the logarithms of the weights, up to a constant: [..., K] of [..., K, H]."""
        count, size = beliefs.shape[-2:]
        match self.fusion:
            case "attention":
                query = nn.Dense(size, name="query")(inputs)
                return jnp.sum(query[..., None, :] * beliefs, axis=-1) / size**0.5
            case "softmax":
                scores: jax.Array = nn.Dense(count, name="scores")(inputs)
                return scores
            case "average":
                return jnp.zeros(beliefs.shape[:-1], jnp.float32)
        raise unknown("fusion of beliefs", self.fusion, ("attention", "softmax", "average"))

    @nn.nowrap
    def initial(self, lanes: int) -> dict[str, Any]:
        """Returns the empty memories by name."""
        return {name: part.initial(lanes) for name, part in self.memories.items()}
