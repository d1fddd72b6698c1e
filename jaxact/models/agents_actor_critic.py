"""The actor-critic of worlds with several agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.agents import as_agents, as_lanes
from jaxact.errors import JaxactError, unknown
from jaxact.models.actor_critic import flatten_action
from jaxact.models.encoders import check_features
from jaxact.models.heads import ActorHead
from jaxact.models.memory import GRU
from jaxact.models.output import ActorCriticOutput
from jaxact.spaces import Agents
from jaxact.team_distributions import check_team

SHARED = ("all", "body", "nothing")


class AgentsActorCritic(nn.Module):
    """A recurrent actor-critic for each agent, with parameters in common or apart.

    With a critic of its own for each agent it is independent PPO's (C. Schroeder de Witt et al.
    2020, https://arxiv.org/abs/2011.09533), with a central one multi-agent PPO's (C. Yu et al.
    2022, https://arxiv.org/abs/2103.01955).

    Attributes:
      action_space: what each agent chooses from, `Agents`.
      encoder: module from named observations [..., …] to features [..., F].
      memory: `GRU`, `LSTM`, `NoMemory`, or a module with the same methods.
      shared: the parameters that agents have in common: "all", "body" (encoder and memory; each
        agent has an actor and a critic of its own) or "nothing".
      central_critic: whether values are estimated from what all agents remember, side by side.
        Acting needs nobody else's.
      identity: whether each agent is told which one it is, as a further feature; with parameters
        in common this is what lets them take different parts.
      previous_action: whether an agent's previous action is fed back as an input.
      team_actor: a module from what all agents remember, float32 [..., A, F], to a
        `TeamDistribution` of their joint actions, such as `CentralActor` and `SyncActor`; None if
        each agent has a policy of its own.
    """

    action_space: Agents
    encoder: nn.Module
    memory: nn.Module = GRU(128)
    shared: str = "all"
    central_critic: bool = False
    identity: bool = False
    previous_action: bool = False
    team_actor: nn.Module | None = None

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
          observation: named arrays [B, A, ...], or time-major [T, B, A, ...].
          memory: as `initial_memory` returns it, [B, A, ...], before the first step.
          previous_action: the actions before each observation, [B, A, ...] or [T, B, A, ...].
          is_first: bool [B] or [T, B], true where an episode begins.

        Returns:
          Policies and values, [B, A] or [T, B, A], and the memory after the last step. The extras
          have the encoder's "embedding" and the "belief" that the actors see, float32 [..., A, F].

        Raises:
          JaxactError: there is no such way of sharing, or a team's actor is for other actions.
        """
        if self.shared not in SHARED:
            raise unknown("way of sharing parameters", self.shared, SHARED)
        axis = is_first.ndim
        apart = self.shared == "nothing"
        features = embedding = self._each(lambda m, x: m(x), apart, axis)(self.encoder, observation)
        check_features(features, (*is_first.shape, self.action_space.count))
        extra = []
        if self.previous_action:
            flat = flatten_action(self.action_space, previous_action)
            first = is_first.reshape(*is_first.shape, 1, 1)
            extra.append(jnp.where(first, 0.0, flat))
        if self.identity:
            who = jnp.eye(self.action_space.count, dtype=jnp.float32)
            extra.append(jnp.broadcast_to(who, (*features.shape[:-1], self.action_space.count)))
        features = jnp.concatenate([features, *extra], axis=-1)
        features, memory = self._remember(features, memory, is_first)

        own = self.shared != "all"
        distribution = (
            self._each(lambda m, x: m(x), own, axis)(
                ActorHead(self.action_space.space, name="actor"), features
            )
            if self.team_actor is None
            else self.team_actor(features)
        )
        if self.team_actor is not None:
            check_team(distribution, self.action_space)
        outputs = self.action_space.count if self.central_critic else 1
        initial = nn.initializers.orthogonal(1.0)
        critic = nn.Dense(outputs, kernel_init=initial, name="critic")
        if self.central_critic:
            value = critic(features.reshape(*features.shape[:-2], -1))
        else:
            value = self._each(lambda m, x: m(x), own, axis)(critic, features)[..., 0]
        extras = {"embedding": embedding, "belief": features}
        return ActorCriticOutput(distribution, value, extras), memory

    def _each(self, call: Callable[..., Any], apart: bool, axis: int) -> Callable[..., Any]:
        """Makes a call of a module on [..., A, ...] one of a module for each agent, if apart."""
        if not apart:
            return call
        return nn.vmap(
            call,
            in_axes=axis,
            out_axes=axis,
            variable_axes={"params": 0},
            split_rngs={"params": True},
        )

    def _remember(
        self, features: jax.Array, memory: Any, is_first: jax.Array
    ) -> tuple[jax.Array, Any]:
        agents, lead = self.action_space.count, is_first.ndim
        if self.shared != "nothing":
            first = jnp.repeat(is_first, agents, axis=-1)
            features, memory = self.memory(as_lanes(features, lead), as_lanes(memory, 1), first)
            return as_agents(features, lead, agents), as_agents(memory, 1, agents)
        each = nn.vmap(
            lambda module, *inputs: module(*inputs),
            in_axes=(lead, 1, None),
            out_axes=(lead, 1),
            variable_axes={"params": 0},
            split_rngs={"params": True},
        )
        features, memory = each(self.memory, features, memory, is_first)
        return features, memory

    @nn.nowrap
    def initial_memory(self, lanes: int) -> Any:
        """Returns the memory of `lanes` lanes that have seen nothing, [lanes, A, ...].

        Raises:
          JaxactError: the actions are one agent's.
        """
        if not isinstance(self.action_space, Agents):
            raise JaxactError(
                f"AgentsActorCritic chooses for several agents, not from {self.action_space}: use "
                "ActorCritic for a world of one"
            )
        agents = self.action_space.count
        return as_agents(self.memory.initial(lanes * agents), 1, agents)
