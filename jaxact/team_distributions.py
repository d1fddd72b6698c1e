"""Distributions over the joint actions of a team, as policies of worlds of several agents.

The last batch axis is that of agents, or of lanes with their agents inside: each A of its entries
after one another are a team, so that nothing changes when `jaxact.agents.as_lanes` makes one axis
of lanes and agents. A team draws, and its action has a probability, as one: every agent is told
the log-probability and the entropy of the whole team.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.distributions import Categorical, Distribution
from jaxact.errors import JaxactError
from jaxact.spaces import Agents, Discrete


class TeamDistribution(Distribution):
    """Over the discrete actions 0 … n − 1 of each agent of a team, [..., X] with X = teams · A."""

    agents: int

    @abstractmethod
    def joint_log_probs(self) -> jax.Array:
        """Returns the log-probability of every joint action, float32 [..., X / A, n, …, n]."""

    def mode(self) -> jax.Array:
        """Returns the most likely joint action, int32 [..., X]."""
        table = self.joint_log_probs()
        flat = table.reshape(*table.shape[: -self.agents], -1)
        return _actions_of(jnp.argmax(flat, axis=-1), table.shape[-1], self.agents)

    def entropy(self) -> jax.Array:
        """Returns the joint action's entropy in nats, for each agent, float32 [..., X]."""
        table = self.joint_log_probs()
        flat = table.reshape(*table.shape[: -self.agents], -1)
        return jnp.repeat(-jnp.sum(jnp.exp(flat) * flat, axis=-1), self.agents, axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class JointCategorical(TeamDistribution):
    """Any distribution of joint actions: what a central policy chooses by.

    Attributes:
      logits: float32 [..., X, nᴬ], the first agent's action changing slowest; the same for all
        agents of a team.
      agents: A.
    """

    logits: jax.Array
    agents: int = field(metadata={"static": True})

    @property
    def _team(self) -> Categorical:
        return Categorical(_teams(self.logits, 1, self.agents)[..., 0, :])

    @property
    def _actions(self) -> int:
        return round(self.logits.shape[-1] ** (1 / self.agents))

    def joint_log_probs(self) -> jax.Array:  # noqa: D102
        table = jax.nn.log_softmax(self._team.logits)
        return table.reshape(*table.shape[:-1], *(self._actions,) * self.agents)

    def sample(self, key: jax.Array) -> jax.Array:
        """Draws a joint action for each team, int32 [..., X]."""
        return _actions_of(self._team.sample(key), self._actions, self.agents)

    def log_prob(self, action: jax.Array) -> jax.Array:
        """Returns that of the team's action, for each agent, float32 [..., X]."""
        own = _teams(action, 0, self.agents)
        index = jnp.zeros(own.shape[:-1], jnp.int32)
        for i in range(self.agents):
            index = index * self._actions + own[..., i]
        return jnp.repeat(self._team.log_prob(index), self.agents, axis=-1)

    def kl(self, other: JointCategorical) -> jax.Array:
        """Returns that of the joint actions, for each agent, float32 [..., X]."""
        return jnp.repeat(self._team.kl(other._team), self.agents, axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MixtureOfMarginals(TeamDistribution):
    """Σₖ αₖ Πᵢ πᵢᵏ: one of m components is drawn by all together, then each agent draws by itself.

    It is SYNC's, of U. Jain et al. 2020 (https://arxiv.org/abs/2007.04979), section 4: agents that
    share a source of randomness need not be told what the others do, and yet act in concert. The
    table of two agents' joint probabilities has rank m at most.

    Attributes:
      logits: of πᵢᵏ, float32 [..., X, m, n].
      weights: logits of α, float32 [..., X, m]; the same for all agents of a team.
      agents: A.
    """

    logits: jax.Array
    weights: jax.Array
    agents: int = field(metadata={"static": True})

    @property
    def _component(self) -> Categorical:
        return Categorical(_teams(self.weights, 1, self.agents)[..., 0, :])

    def joint_log_probs(self) -> jax.Array:  # noqa: D102
        own = jax.nn.log_softmax(_teams(self.logits, 2, self.agents))
        total = jax.nn.log_softmax(self._component.logits)
        total = total.reshape(*total.shape, *(1,) * self.agents)
        for i in range(self.agents):
            shape = [1] * self.agents
            shape[i] = own.shape[-1]
            total = total + own[..., i, :, :].reshape(*own.shape[:-3], own.shape[-2], *shape)
        return jax.nn.logsumexp(total, axis=-1 - self.agents)

    def sample(self, key: jax.Array) -> jax.Array:
        """Draws a component for each team, and an action for each agent, int32 [..., X]."""
        component_key, action_key = jax.random.split(key)
        component = self._component.sample(component_key)
        own = _teams(self.logits, 2, self.agents)
        chosen = jax.nn.one_hot(component, own.shape[-2], dtype=own.dtype)
        logits = jnp.sum(own * chosen[..., None, :, None], axis=-2)
        action = Categorical(logits).sample(action_key)
        return action.reshape(*action.shape[:-2], -1)

    def log_prob(self, action: jax.Array) -> jax.Array:
        """Returns that of the team's action, for each agent, float32 [..., X]."""
        own = _teams(action, 0, self.agents)[..., None]
        each = Categorical(_teams(self.logits, 2, self.agents)).log_prob(own)
        together = jnp.sum(each, axis=-2) + jax.nn.log_softmax(self._component.logits)
        return jnp.repeat(jax.nn.logsumexp(together, axis=-1), self.agents, axis=-1)


def joint_log_probs(distribution: Distribution, agents: int) -> jax.Array:
    """Returns the log-probabilities of all joint actions, of whichever policy.

    Args:
      distribution: a `TeamDistribution`, or the agents' own `Categorical` policies [..., X, n].
      agents: A, how many are in a team.

    Returns:
      float32 [..., X / A, n, …, n].

    Raises:
      JaxactError: it is neither.
    """
    if isinstance(distribution, TeamDistribution):
        return distribution.joint_log_probs()
    if not isinstance(distribution, Categorical):
        raise JaxactError(
            "joint actions have a table of probabilities if agents choose from discrete actions, "
            f"and the policy is a {type(distribution).__name__}"
        )
    own = jax.nn.log_softmax(_teams(distribution.logits, 1, agents))
    total = jnp.zeros((*own.shape[:-2], *(1,) * agents), own.dtype)
    for i in range(agents):
        shape = [1] * agents
        shape[i] = own.shape[-1]
        total = total + own[..., i, :].reshape(*own.shape[:-2], *shape)
    return total


def check_team(distribution: Distribution, space: Agents) -> None:
    """Refuses a team's distribution over other actions than its world's.

    Raises:
      JaxactError: agents do not choose from as many actions, or from other than discrete ones.
    """
    own = space.space
    if not isinstance(own, Discrete):
        raise JaxactError(
            f"teams choose from discrete actions together, and these agents from {own}: leave out "
            "team_actor, which gives each a policy of its own"
        )
    table = jax.eval_shape(lambda policy: joint_log_probs(policy, space.count), distribution)
    if table.shape[-1] != own.n:
        raise JaxactError(
            f"the team's actor chooses from {table.shape[-1]} actions of each agent, and the world "
            f"has {own.n}: give it actions={own.n}"
        )


def _teams(x: Any, event: int, agents: int) -> jax.Array:
    """Parts the last batch axis: [..., X, *event] to [..., X / A, A, *event]."""
    axis = x.ndim - event - 1
    return jnp.reshape(x, (*x.shape[:axis], -1, agents, *x.shape[axis + 1 :]))


def _actions_of(index: jax.Array, actions: int, agents: int) -> jax.Array:
    """Returns the agents' actions int32 [..., G · A] from places int32 [..., G] in their table."""
    parts = [index // actions ** (agents - 1 - i) % actions for i in range(agents)]
    own = jnp.stack(parts, axis=-1).astype(jnp.int32)
    return own.reshape(*own.shape[:-2], -1)
