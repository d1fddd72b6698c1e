"""Actor heads for every action space."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.distributions import Categorical, DiagonalNormal, Distribution, Joint
from jaxact.spaces import Box, Dict, Discrete, Space, Tuple

# Small, so that the first policy is nearly uniform.
_INITIAL = nn.initializers.orthogonal(0.01)


class ActorHead(nn.Module):
    """From features to a distribution over the actions of a space.

    Discrete spaces get a categorical, boxes a diagonal normal with a learnt, state-independent
    deviation, tuples and dicts a joint of independent parts.

    Attributes:
      space: the action space.
    """

    space: Space

    @nn.compact
    def __call__(self, features: jax.Array) -> Distribution:
        """Maps [batch, F] to a distribution with the same batch axes."""
        match self.space:
            case Discrete(n):
                return Categorical(nn.Dense(n, kernel_init=_INITIAL)(features))
            case Box(shape=(size,)):
                mean = nn.Dense(size, kernel_init=_INITIAL)(features)
                log_std = self.param("log_std", nn.initializers.zeros, (size,), jnp.float32)
                return DiagonalNormal(mean, jnp.broadcast_to(log_std, mean.shape))
            case Tuple(spaces):
                return Joint(tuple(ActorHead(space)(features) for space in spaces))
            case Dict(spaces):
                return Joint(
                    {name: ActorHead(s, name=name)(features) for name, s in spaces.items()}
                )
        raise TypeError(f"no actor head for the action space {self.space}")
