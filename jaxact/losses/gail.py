"""Imitation of demonstrations by telling them from what the policy does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.actor_critic import flatten_action
from jaxact.models.output import ActorCriticOutput
from jaxact.moments import Moments, scale_by_returns
from jaxact.pomdp import PyTree
from jaxact.spaces import Space


@dataclass(frozen=True, kw_only=True)
class GAIL(Loss):
    """Generative adversarial imitation learning (Ho & Ermon 2016, https://arxiv.org/abs/1606.03476).

    A discriminator D = σ(f(s, a)) learns to tell demonstrations (1) from the policy's own steps
    (0), and the policy is rewarded for passing as a demonstrator. It takes two of this loss, of one
    name, which therefore share D: one among the stage's losses, and one with
    `demonstrations=True` among those of a storage. For D to hear both alike, the storage needs as
    many `updates` as a rollout has gradient steps, epochs × minibatches. The environment's own
    reward can be left out by `Stage.rewards`, for example {"success": 0.0}.

    The reward −log(1 − D) is never negative, so that where success ends an episode the policy is
    paid for putting it off (Kostrikov et al. 2019, https://arxiv.org/abs/1809.02925); the logit can
    be of either sign.

    Attributes:
      action_space: of the actions.
      encoder: module from named observations [..., …] to features [..., F].
      hidden: size of the discriminator's two hidden layers.
      demonstrations: whether what it is given is the demonstrators', not the policy's.
      logit_reward: whether the reward is f, divided by the running deviation of its discounted sums
        (as in ADVISOR's experiments), rather than −log(1 − D).
      discount: γ of those sums.
      gradient_penalty: c of c ½‖∇D's logit‖² by features and action (Mescheder et al. 2018,
        https://arxiv.org/abs/1801.04406); None for none.
    """

    action_space: Space
    encoder: nn.Module
    hidden: int = 128
    demonstrations: bool = False
    logit_reward: bool = False
    discount: float = 0.99
    gradient_penalty: float | None = None

    @property
    def _discriminator(self) -> nn.Module:
        hidden: list[Any] = [nn.Dense(self.hidden), nn.tanh, nn.Dense(self.hidden), nn.tanh]
        return nn.Sequential([*hidden, nn.Dense(1)])

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the parameters of encoder and discriminator, and the rewards' statistics."""
        del output
        encoder_key, discriminator_key = jax.random.split(key)
        features, encoder = self.encoder.init_with_output(encoder_key, observation)
        inputs = self._beside(features, action)
        discriminator = self._discriminator.init(discriminator_key, inputs)
        return {
            "params": {
                "encoder": encoder.get("params", {}),
                "discriminator": discriminator["params"],
            },
            "statistics": {"return": Moments.of_none()},
        }

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns −log D of demonstrations or −log(1 − D) of the policy's steps, as cross_entropy,
        and accuracy, the fraction told right.
        """
        del output, progress
        inputs = self._inputs(variables, batch.observation, batch.action)
        right = self._logit(variables, inputs) * (1.0 if self.demonstrations else -1.0)
        loss = cross_entropy = batch.mean(jax.nn.softplus(-right))
        parts = {
            "cross_entropy": cross_entropy,
            "accuracy": batch.mean((right > 0).astype(jnp.float32)),
        }
        if self.gradient_penalty is not None:
            # Each step's logit depends on its own inputs alone, so that the gradient of the sum is
            # that of each.
            slope = jax.grad(lambda x: jnp.sum(self._logit(variables, x)))(inputs)
            parts["penalty"] = batch.mean(0.5 * jnp.sum(jnp.square(slope), axis=-1))
            loss = loss + self.gradient_penalty * parts["penalty"]
        return loss, parts

    def reward(
        self, variables: dict[str, PyTree], trajectory: Any, axis_name: str | None
    ) -> tuple[jax.Array, dict[str, PyTree]]:
        """Returns −log(1 − D) or the scaled logit of every step, float32 [T, B]."""
        inputs = self._inputs(variables, trajectory.observation, trajectory.action)
        logit = self._logit(variables, inputs)
        if not self.logit_reward:
            return jax.nn.softplus(logit), variables
        moments = variables["statistics"]["return"]
        reward, moments = scale_by_returns(moments, logit, self.discount, axis_name)
        return reward, {**variables, "statistics": {"return": moments}}

    def _inputs(self, variables: dict[str, PyTree], observation: PyTree, action: PyTree) -> Any:
        params = variables["params"]["encoder"]
        return self._beside(self.encoder.apply({"params": params}, observation), action)

    def _beside(self, features: Any, action: PyTree) -> jax.Array:
        return jnp.concatenate([features, flatten_action(self.action_space, action)], axis=-1)

    def _logit(self, variables: dict[str, PyTree], inputs: jax.Array) -> jax.Array:
        params = variables["params"]["discriminator"]
        logit: Any = self._discriminator.apply({"params": params}, inputs)
        result: jax.Array = logit[..., 0]
        return result
