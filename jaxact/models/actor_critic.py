"""The default actor-critic: encoder, memory, actor and critic heads."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.beliefs import Beliefs
from jaxact.models.encoders import check_features
from jaxact.models.heads import SMALL, ActorHead, check_one_agent
from jaxact.models.memory import GRU
from jaxact.models.output import ActorCriticOutput
from jaxact.spaces import Agents, Box, Dict, Discrete, Space, Tuple


class ActorCritic(nn.Module):
    """A recurrent actor-critic.

    Any linen module with the same two methods can take its place: `__call__` as here, and
    `initial_memory(lanes)`, which returns the memory of lanes that have seen nothing.

    Attributes:
      action_space: what the policy chooses from.
      encoder: module from named observations [..., …] to features [..., F].
      memory: `GRU`, `LSTM`, `NoMemory`, `MultipleBeliefs`, or a module with the same methods.
      previous_action: whether the previous action is fed back as an input.
      auxiliary_actor: whether there is a second actor head on the same features, for losses that
        compare two policies (ADVISOR); the output's extras have its "auxiliary_distribution".
      squashed: whether actions in boxes are squashed into their bounds, see `ActorHead`.
      actor_gain: of the actors' initial weights; AllenAct's is 1, with which first policies differ
        from the uniform one, and two actors from each other.
    """

    action_space: Space
    encoder: nn.Module
    memory: nn.Module = GRU(128)
    previous_action: bool = False
    auxiliary_actor: bool = False
    squashed: bool = False
    actor_gain: float = SMALL

    @nn.compact
    def __call__(
        self,
        observation: Mapping[str, jax.Array],
        memory: Any,
        previous_action: Any,
        is_first: jax.Array,
    ) -> tuple[ActorCriticOutput, Any]:
        """Runs one step or a whole sequence.

        Args:
          observation: named arrays [B, ...], or time-major [T, B, ...].
          memory: as `initial_memory` returns it, [B, ...], before the first step.
          previous_action: the action before each observation, [B, ...] or [T, B, ...].
          is_first: bool [B] or [T, B], true where an episode begins.

        Returns:
          Policy and value, [B] or [T, B], and the memory after the last step. The extras have the
          encoder's "embedding" and the "belief" that the heads see, float32 [..., F]; of
          `MultipleBeliefs` also every belief under its name, and the weights of their "fusion".
        """
        check_one_agent(self, self.action_space)
        features = embedding = self.encoder(observation)
        check_features(features, is_first.shape)
        if self.previous_action:
            flat = flatten_action(self.action_space, previous_action)
            flat = jnp.where(is_first[..., None], 0.0, flat)
            features = jnp.concatenate([features, flat], axis=-1)
        features, memory = self.memory(features, memory, is_first)
        extras: dict[str, Any] = {}
        if isinstance(features, Beliefs):
            extras = {**features.named, "fusion": features.weights}
            features = features.fused
        actor = partial(ActorHead, self.action_space, self.squashed, self.actor_gain)
        distribution = actor(name="actor")(features)
        value = nn.Dense(1, kernel_init=nn.initializers.orthogonal(1.0), name="critic")(features)
        extras |= {"embedding": embedding, "belief": features}
        if self.auxiliary_actor:
            extras["auxiliary_distribution"] = actor(name="auxiliary_actor")(features)
        return ActorCriticOutput(distribution, value[..., 0], extras), memory

    @nn.nowrap
    def initial_memory(self, lanes: int) -> Any:
        """Returns the memory of `lanes` lanes that have seen nothing."""
        return self.memory.initial(lanes)


def flatten_action(space: Space, action: Any) -> jax.Array:
    """Lays actions out as vectors: discrete ones one-hot, boxes flat, parts side by side.

    Args:
      space: the action space.
      action: values of it with any leading axes.

    Returns:
      float32 [..., D].
    """
    match space:
        case Discrete(n):
            return jax.nn.one_hot(action, n, dtype=jnp.float32)
        case Agents(each):
            return flatten_action(each, action)
        case Box(shape=shape):
            lead = action.shape[: action.ndim - len(shape)]
            return action.astype(jnp.float32).reshape((*lead, -1))
        case Tuple(spaces):
            parts = [flatten_action(s, a) for s, a in zip(spaces, action, strict=True)]
        case Dict(spaces):
            parts = [flatten_action(s, action[name]) for name, s in spaces.items()]
        case _:
            raise TypeError(f"actions of {space} cannot be laid out as vectors")
    return jnp.concatenate(parts, axis=-1)
