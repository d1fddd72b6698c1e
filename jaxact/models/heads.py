"""Actor heads for every action space."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from jaxact.distributions import (
    Categorical,
    DiagonalNormal,
    Distribution,
    Joint,
    SquashedNormal,
)
from jaxact.errors import JaxactError
from jaxact.models.encoders import RELU
from jaxact.spaces import Agents, Box, Dict, Discrete, Space, Tuple

# Gain of initial weights, small, so that the first policy is nearly uniform.
SMALL = 0.01
_INITIAL = nn.initializers.orthogonal(SMALL)
# Bounds on a squashed normal's log-deviation, of Haarnoja et al. 2018.
_LOG_STD = (-20.0, 2.0)


class ActorHead(nn.Module):
    """From features to a distribution over the actions of a space.

    Discrete spaces get a categorical, boxes a diagonal normal with a learnt, state-independent
    deviation, tuples and dicts a joint of independent parts.

    Attributes:
      space: the action space.
      squashed: whether boxes, which must be bounded, get a `SquashedNormal` instead, with a
        deviation that depends on the features, as SAC wants it.
      gain: of the orthogonal initial weights.
    """

    space: Space
    squashed: bool = False
    gain: float = SMALL

    @nn.compact
    def __call__(self, features: jax.Array) -> Distribution:
        """Maps [batch, F] to a distribution with the same batch axes."""
        initial = nn.initializers.orthogonal(self.gain)
        match self.space:
            case Discrete(n):
                return Categorical(nn.Dense(n, kernel_init=initial)(features))
            case Box(shape=(size,)) if self.squashed:
                return _squashed(self.space, nn.Dense(2 * size, kernel_init=initial)(features))
            case Box(shape=(size,)):
                mean = nn.Dense(size, kernel_init=initial)(features)
                log_std = self.param("log_std", nn.initializers.zeros, (size,), jnp.float32)
                return DiagonalNormal(mean, jnp.broadcast_to(log_std, mean.shape))
            case Tuple(spaces):
                return Joint(
                    tuple(ActorHead(s, self.squashed, self.gain)(features) for s in spaces)
                )
            case Dict(spaces):
                return Joint(
                    {
                        n: ActorHead(s, self.squashed, self.gain, name=n)(features)
                        for n, s in spaces.items()
                    }
                )
        raise TypeError(f"no actor head for the action space {self.space}")


def check_one_agent(model: nn.Module, space: Space) -> None:
    """Refuses to choose for several agents, for models without an axis of them.

    Raises:
      JaxactError: the actions are of several.
    """
    if isinstance(space, Agents):
        raise JaxactError(
            f"{type(model).__name__} chooses for one agent, and this is a world of {space.count} "
            "agents: use AgentsActorCritic, or leave one of them to learn with "
            "jaxact.opponents.against"
        )


def _squashed(space: Box, parameters: jax.Array) -> SquashedNormal:
    if not np.isfinite([space.low, space.high]).all():
        raise JaxactError(f"a squashed policy needs bounds on the actions, and {space} has none")
    mean, log_std = jnp.split(parameters, 2, axis=-1)
    log_std = jnp.clip(log_std, *_LOG_STD)
    centre = jnp.full_like(mean, 0.5 * (space.low + space.high))
    return SquashedNormal(mean, log_std, centre, jnp.full_like(mean, space.high) - centre)


class ActionValueHead(nn.Module):
    """From features to action values.

    Attributes:
      actions: how many there are.
      hidden: size of the layer before the values; if dueling, of that before each of the two.
      layer_norm: whether that layer is normalised (Ba et al. 2016).
      dueling: whether they are made as value plus advantage (Wang et al. 2016, equation 9).
    """

    actions: int
    hidden: int
    layer_norm: bool = False
    dueling: bool = True

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Maps [batch, F] to Q, float32 [batch, actions]."""
        if not self.dueling:
            q: jax.Array = nn.Dense(self.actions, kernel_init=_INITIAL)(self._layer(features))
            return q
        value = nn.Dense(1, kernel_init=_INITIAL)(self._layer(features))
        advantage = nn.Dense(self.actions, kernel_init=_INITIAL)(self._layer(features))
        return value + advantage - jnp.mean(advantage, axis=-1, keepdims=True)

    def _layer(self, features: jax.Array) -> jax.Array:
        hidden = nn.Dense(self.hidden, kernel_init=RELU)(features)
        return nn.relu(nn.LayerNorm()(hidden) if self.layer_norm else hidden)
