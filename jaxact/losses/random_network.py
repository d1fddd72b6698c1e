"""Random network distillation: a reward for observations unlike those seen before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.moments import Moments, scale_by_returns
from jaxact.pomdp import PyTree


@dataclass(frozen=True, kw_only=True)
class RandomNetworkDistillation(Loss):
    """RND (Burda et al. 2018, https://arxiv.org/abs/1810.12894).

    A predictor learns what a random network, which never changes, says of the observations; the
    reward of a step is the mean squared error on the observation it leads to, divided by the
    running deviation of the errors' discounted sums. Readings of floats are normalised by running
    statistics and clipped to ±5 first; codes, tokens and pixels go to the encoder as they are.

    A batch does not hold the final observations of episodes. They are not learnt from, so nor are
    they rewarded.

    Attributes:
      encoder: module from named observations [..., …] to features [..., F], for both networks.
      features: size of what they say.
      hidden: size of the predictor's two further layers.
      discount: γ of the sums.
    """

    encoder: nn.Module
    features: int = 128
    hidden: int = 256
    discount: float = 0.99

    @property
    def _target(self) -> nn.Module:
        return nn.Sequential([self.encoder, nn.Dense(self.features)])

    @property
    def _predictor(self) -> nn.Module:
        further: list[Any] = [nn.Dense(self.hidden), nn.relu, nn.Dense(self.hidden), nn.relu]
        return nn.Sequential([self.encoder, *further, nn.Dense(self.features)])

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the predictor's parameters, the target's, and the statistics so far: none."""
        del output, action
        target_key, predictor_key = jax.random.split(key)
        return {
            "params": self._predictor.init(predictor_key, observation)["params"],
            "target": self._target.init(target_key, observation)["params"],
            "statistics": {
                "observation": {
                    name: Moments.of_none(*x.shape[1:])
                    for name, x in observation.items()
                    if jnp.issubdtype(x.dtype, jnp.floating)
                },
                "return": Moments.of_none(),
            },
        }

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the mean squared error, `error`."""
        del output, progress
        error = batch.mean(self._error(variables, batch.observation))
        return error, {"error": error}

    def reward(
        self, variables: dict[str, PyTree], trajectory: Any, axis_name: str | None
    ) -> tuple[jax.Array, dict[str, PyTree]]:
        """Returns the scaled errors of every step that does not end an episode, float32 [T, B]."""
        statistics = variables["statistics"]
        seen = {
            name: moments.update(trajectory.step.observation[name], axis_name)
            for name, moments in statistics["observation"].items()
        }
        variables = {**variables, "statistics": {**statistics, "observation": seen}}
        error = self._error(variables, trajectory.step.observation)
        error = jnp.where(trajectory.step.finished, 0.0, error)
        reward, sums = scale_by_returns(statistics["return"], error, self.discount, axis_name)
        return reward, {**variables, "statistics": {"observation": seen, "return": sums}}

    def _error(self, variables: dict[str, PyTree], observation: PyTree) -> jax.Array:
        moments = variables["statistics"]["observation"]
        seen = {
            name: jnp.clip(moments[name].normalize(x), -5.0, 5.0) if name in moments else x
            for name, x in observation.items()
        }
        target: Any = self._target.apply({"params": variables["target"]}, seen)
        guess: Any = self._predictor.apply({"params": variables["params"]}, seen)
        return jnp.mean(jnp.square(guess - jax.lax.stop_gradient(target)), axis=-1)
