"""Soft actor-critic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.distributions import SquashedNormal
from jaxact.errors import JaxactError
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.target import Target
from jaxact.models.encoders import RELU
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.returns import known_transitions


class Critic(nn.Module):
    """Action values of continuous actions.

    Attributes:
      encoder: module from named observations [..., …] to features [..., F].
      hidden: sizes of the layers on features and action.
    """

    encoder: nn.Module
    hidden: Sequence[int] = (64, 64)

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array], action: jax.Array) -> jax.Array:
        """Maps observations and actions [..., D] to Q(s, a), float32 [...]."""
        x = jnp.concatenate([self.encoder(observation), action], axis=-1)
        for size in self.hidden:
            x = nn.relu(nn.Dense(size, kernel_init=RELU)(x))
        return nn.Dense(1)(x)[..., 0]


@dataclass(frozen=True, kw_only=True)
class SAC(Loss):
    """Soft actor-critic (Haarnoja et al. 2018, https://arxiv.org/abs/1812.05905).

    Two critics, which are the loss's own and see the present observation, learn
    y = r + γ (min Q'(s', a') − α log π(a' | s')) with a' of the present policy and Q' their Polyak
    averages; the actor minimises α log π(a | s) − min Q(s, a), and the temperature
    −log α (log π(a | s) + target entropy). For `ActorCritic(..., squashed=True)` and actions in a
    bounded box, on a `Replay` of sequences of two steps or more: a step's successor is the next
    row, so that of each sequence all but the last step are learnt from, and those that were
    truncated are not. The model's own value is not used.

    Whatever the box, actions are reckoned as of the box from −1 to 1: the critics are given those,
    and entropies are of those, so that the unit that a world measures its actions in means nothing.

    Attributes:
      critic: of which there are two; see `Critic`.
      discount: γ.
      temperature: the first α.
      target_entropy: for each dimension of the action, in nats; of the whole box it is log 2.
      target: how the critics' averages follow.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"reward"})

    critic: Critic
    discount: float = 0.99
    temperature: float = 0.1
    target_entropy: float = -1.0
    target: Target = field(default_factory=lambda: Target(rate=0.005))

    _names: ClassVar[tuple[str, str]] = ("critic_0", "critic_1")

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses policies other than those squashed into a box."""
        if not isinstance(output.distribution, SquashedNormal):
            raise JaxactError(
                "SAC is for policies on a bounded box, ActorCritic(..., squashed=True), not for "
                f"{type(output.distribution).__name__}"
            )

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the critics, the logarithm of the temperature, and the number of gradient steps
        taken; `follow` adds the critics' averages.
        """
        del output
        critics = {
            name: self.critic.init(key, observation, action)
            for name, key in zip(self._names, jax.random.split(key), strict=True)
        }
        params = {**critics, "log_temperature": jnp.log(jnp.asarray(self.temperature, jnp.float32))}
        return {"params": params, "steps": jnp.int32(0)}

    def follow(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Lets the averages follow the critics."""
        del params
        critics = {name: variables["params"][name] for name in self._names}
        if "target" not in variables:
            return {**variables, "target": critics}
        steps = variables["steps"] + 1
        target = self.target.follow(variables["target"], critics, steps)
        return {**variables, "steps": steps, "target": target}

    def __call__(
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: Any = None,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: critic, actor, temperature (α), entropy (−log π), q."""
        del progress
        known = known_transitions(batch.terminated, batch.truncated)
        box: Any = output.distribution
        action, log_prob = _draw(box, batch.key)
        taken = (batch.action - box.centre) / box.half
        own = variables["params"]
        log_temperature = own["log_temperature"]
        temperature = jax.lax.stop_gradient(jnp.exp(log_temperature))

        soft = self._least(variables["target"], batch.observation, action) - temperature * log_prob
        after = jnp.where(batch.terminated, 0.0, jnp.roll(soft, -1, axis=0))
        target = jax.lax.stop_gradient(batch.reward + self.discount * after)
        chosen = self._values(own, batch.observation, taken)
        errors = jnp.square(chosen[0] - target) + jnp.square(chosen[1] - target)
        critic = 0.5 * batch.mean(errors, where=known)

        value = self._least(jax.lax.stop_gradient(own), batch.observation, action)
        actor = batch.mean(temperature * log_prob - value, where=known)
        wanted = self.target_entropy * batch.action.shape[-1]
        excess = batch.mean(jax.lax.stop_gradient(log_prob + wanted), where=known)
        return critic + actor - log_temperature * excess, {
            "critic": critic,
            "actor": actor,
            "temperature": temperature,
            "entropy": -batch.mean(log_prob, where=known),
            "q": batch.mean(chosen[0], where=known),
        }

    def _values(self, critics: PyTree, observation: PyTree, action: jax.Array) -> list[jax.Array]:
        """Returns both critics' values."""
        critic: Any = self.critic
        return [critic.apply(critics[name], observation, action) for name in self._names]

    def _least(self, critics: PyTree, observation: PyTree, action: jax.Array) -> jax.Array:
        return jnp.minimum(*self._values(critics, observation, action))


def _draw(distribution: Any, keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Draws actions [T, B, D] of the box from −1 to 1, by a key of each lane's own [B], and returns
    their log-densities there.
    """
    draw = jax.vmap(lambda d, key: d.sample_with_log_prob(key), (1, 0), 1)
    action, log_prob = draw(distribution, keys)
    unit = (action - distribution.centre) / distribution.half
    return unit, log_prob + jnp.sum(jnp.log(distribution.half), axis=-1)
