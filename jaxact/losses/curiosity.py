"""Curiosity: a reward for what the agent cannot predict of the outcome of its own actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.distributions import Distribution
from jaxact.losses.base import Batch, Loss, Progress
from jaxact.losses.windows import goes_on, later
from jaxact.models.actor_critic import flatten_action
from jaxact.models.heads import ActorHead
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.spaces import Space


@dataclass(frozen=True, kw_only=True)
class Curiosity(Loss):
    """The intrinsic curiosity module (Pathak et al. 2017, https://arxiv.org/abs/1705.05363).

    An encoder φ of its own is shaped by an inverse model, which guesses a_t of φ_t and φ_{t+1}; a
    forward model guesses φ_{t+1} of φ_t and a_t:

      loss = −(1 − β) log p(a_t | φ_t, φ_{t+1}) + β ½‖φ̂_{t+1} − φ_{t+1}‖²
      reward = η ½‖φ̂_{t+1} − φ_{t+1}‖²

    A batch does not hold the final observations of episodes. They are not learnt from, so nor are
    they rewarded.

    Attributes:
      action_space: of the actions.
      encoder: module from named observations [..., …] to features [..., F].
      hidden: size of the models' hidden layers.
      eta: η.
      beta: β.
    """

    action_space: Space
    encoder: nn.Module
    hidden: int = 256
    eta: float = 0.01
    beta: float = 0.2

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    @property
    def _dynamics(self) -> _Dynamics:
        return _Dynamics(self.action_space, self.hidden)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the parameters of the encoder and of both models."""
        del output
        encoder_key, dynamics_key = jax.random.split(key)
        features, encoder = self.encoder.init_with_output(encoder_key, observation)
        dynamics = self._dynamics.init(dynamics_key, features, features, action)
        return {"params": {"encoder": encoder.get("params", {}), "dynamics": dynamics["params"]}}

    def __call__(  # type: ignore[override]
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: dict[str, PyTree],
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss and its parts: inverse, the cross-entropy, and forward, the error."""
        del output, progress
        features = self._encode(variables, batch.observation)
        guess, error = self._predict(variables, features, later(features, 1), batch.action)
        inside = goes_on(batch.is_first, 1)
        parts = {
            "inverse": -batch.mean(guess.log_prob(batch.action), where=inside),
            "forward": batch.mean(error, where=inside),
        }
        return (1.0 - self.beta) * parts["inverse"] + self.beta * parts["forward"], parts

    def reward(
        self, variables: dict[str, PyTree], trajectory: Any, axis_name: str | None
    ) -> tuple[jax.Array, dict[str, PyTree]]:
        """Returns η ½‖φ̂ − φ‖² of every step that does not end an episode, float32 [T, B]."""
        del axis_name
        before = self._encode(variables, trajectory.observation)
        after = self._encode(variables, trajectory.step.observation)
        _, error = self._predict(variables, before, after, trajectory.action)
        return jnp.where(trajectory.step.finished, 0.0, self.eta * error), variables

    def _encode(self, variables: dict[str, PyTree], observation: PyTree) -> jax.Array:
        params = variables["params"]["encoder"]
        features: Any = self.encoder.apply({"params": params}, observation)
        return jnp.asarray(features)

    def _predict(
        self, variables: dict[str, PyTree], before: jax.Array, after: jax.Array, action: PyTree
    ) -> tuple[Distribution, jax.Array]:
        params = variables["params"]["dynamics"]
        predicted: Any = self._dynamics.apply({"params": params}, before, after, action)
        guess, error = predicted
        return guess, error


class _Dynamics(nn.Module):
    """The inverse and the forward model."""

    action_space: Space
    hidden: int

    @nn.compact
    def __call__(
        self, before: jax.Array, after: jax.Array, action: PyTree
    ) -> tuple[Distribution, jax.Array]:
        """Returns the inverse model's guess of the action, and the forward model's error [...]."""
        both = jnp.concatenate([before, after], axis=-1)
        hidden = nn.relu(nn.Dense(self.hidden, name="inverse_hidden")(both))
        guess = ActorHead(self.action_space, name="inverse")(hidden)
        acted = jnp.concatenate([before, flatten_action(self.action_space, action)], axis=-1)
        hidden = nn.relu(nn.Dense(self.hidden, name="forward_hidden")(acted))
        expected = nn.Dense(after.shape[-1], name="forward")(hidden)
        return guess, 0.5 * jnp.sum(jnp.square(expected - after), axis=-1)
