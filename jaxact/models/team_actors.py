"""Actors of whole teams, from what every agent remembers, for `AgentsActorCritic`."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.encoders import RELU
from jaxact.models.heads import SMALL
from jaxact.team_distributions import JointCategorical, MixtureOfMarginals


class CentralActor(nn.Module):
    """One policy over joint actions, from what all agents remember, side by side.

    Attributes:
      actions: n, of each agent.
      hidden: size of the layer before the nᴬ logits.
    """

    actions: int
    hidden: int = 128

    @nn.compact
    def __call__(self, features: jax.Array) -> JointCategorical:
        """Maps [..., A, F] to a distribution [..., A]."""
        agents = features.shape[-2]
        everything = features.reshape(*features.shape[:-2], -1)
        hidden = nn.relu(nn.Dense(self.hidden, kernel_init=RELU)(everything))
        initial = nn.initializers.orthogonal(SMALL)
        logits = nn.Dense(self.actions**agents, kernel_init=initial)(hidden)[..., None, :]
        return JointCategorical(jnp.repeat(logits, agents, axis=-2), agents)


class SyncActor(nn.Module):
    """SYNC: a mixture of m products of the agents' own policies (U. Jain et al. 2020, section 4.2).

    An agent's policies are made from what it remembers itself. The weights of the mixture are made
    from a short message of each agent, which all of them hear, so that all know them; the one that
    counts is drawn from randomness that they share.

    Attributes:
      actions: n, of each agent.
      components: m; as many as actions in the paper.
      message: size of each agent's message.
      hidden: size of the two layers between the messages and the weights.
    """

    actions: int
    components: int
    message: int = 16
    hidden: int = 64

    @nn.compact
    def __call__(self, features: jax.Array) -> MixtureOfMarginals:
        """Maps [..., A, F] to a distribution [..., A]."""
        agents, initial = features.shape[-2], nn.initializers.orthogonal(SMALL)
        logits = nn.Dense(self.components * self.actions, kernel_init=initial)(features)
        logits = logits.reshape(*features.shape[:-1], self.components, self.actions)
        messages = nn.Dense(self.message)(features)
        heard = messages.reshape(*messages.shape[:-2], -1)
        for _ in range(2):
            heard = nn.relu(nn.Dense(self.hidden, kernel_init=RELU)(heard))
        weights = nn.Dense(self.components, kernel_init=initial)(heard)[..., None, :]
        return MixtureOfMarginals(logits, jnp.repeat(weights, agents, axis=-2), agents)
