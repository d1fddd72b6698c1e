"""A network of action values, for worlds with discrete actions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.distributions import EpsilonGreedy
from jaxact.errors import JaxactError
from jaxact.models.encoders import check_features
from jaxact.models.heads import ActionValueHead, check_one_agent
from jaxact.models.memory import GRU
from jaxact.models.output import ActorCriticOutput
from jaxact.spaces import Discrete, Space


class QNetwork(nn.Module):
    """A recurrent network of action values, in the place of an `ActorCritic`.

    It acts greedily, whether its actions are sampled or its mode is taken; how often it tries
    something else while it learns is the stage's `exploration`.

    Attributes:
      action_space: discrete.
      encoder: module from named observations [..., …] to features [..., F].
      memory: `GRU`, `LSTM`, `NoMemory`, or a module with the same methods.
      hidden: size of the head's layers.
      layer_norm: whether the features and the head's layers are normalised; what keeps `PQN`, which
        has no target network, from diverging.
      dueling: whether values are made as the state's value plus the action's advantage (Wang et al.
        2016), or at once (Mnih et al. 2015).
    """

    action_space: Space
    encoder: nn.Module
    memory: nn.Module = GRU(128)
    hidden: int = 128
    layer_norm: bool = False
    dueling: bool = True

    @nn.compact
    def __call__(
        self,
        observation: Mapping[str, jax.Array],
        memory: Any,
        previous_action: Any,
        is_first: jax.Array,
    ) -> tuple[ActorCriticOutput, Any]:
        """Runs one step or a whole sequence; see `ActorCritic`.

        Returns:
          An `EpsilonGreedy` distribution with ε = 0, the value of the best action, and as extras
          "q", float32 [..., n], besides the "embedding" and "belief" that all models have; and the
          memory after the last step.
        """
        del previous_action
        check_one_agent(self, self.action_space)
        if not isinstance(self.action_space, Discrete):
            raise JaxactError(f"QNetwork is for discrete actions, not for {self.action_space}")
        embedding = self.encoder(observation)
        check_features(embedding, is_first.shape)
        features = nn.LayerNorm()(embedding) if self.layer_norm else embedding
        belief, memory = self.memory(features, memory, is_first)
        head = ActionValueHead(
            self.action_space.n, self.hidden, self.layer_norm, self.dueling, name="q"
        )
        q = head(belief)
        value = jnp.max(q, axis=-1)
        extras = {"q": q, "embedding": embedding, "belief": belief}
        return ActorCriticOutput(EpsilonGreedy(q, jnp.zeros_like(value)), value, extras), memory

    @nn.nowrap
    def initial_memory(self, lanes: int) -> Any:
        """Returns the memory of `lanes` lanes that have seen nothing."""
        return self.memory.initial(lanes)
