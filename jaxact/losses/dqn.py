"""Q-learning from replays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax

from jaxact.errors import JaxactError, check_at_least
from jaxact.losses.base import PRIORITY, TARGET_MODEL, Batch, Loss, Progress
from jaxact.losses.target import Target
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.returns import known_transitions, n_step_returns

# Of h.
_EPSILON = 1e-3


@dataclass(frozen=True, kw_only=True)
class DQN(Loss):
    """Deep Q-learning (Mnih et al. 2015): the Huber loss of Q(s, a) against n-step returns.

    Their last state's value is that of a target network, for the action that the network itself
    finds best (double, van Hasselt et al. 2016). For models with action values, such as `QNetwork`,
    on a `Replay` of sequences of two steps or more: a step's successor is the next row, so that of
    each sequence all but the last step are learnt from, and those that were truncated are not.

    With a recurrent model, `rescale=True`, `n_step=5`, and a `PrioritizedReplay` with burn-in this
    is R2D2 (Kapturowski et al. 2019, https://openreview.net/forum?id=r1lyTjAqYX): values are then
    learnt under h(x) = sign(x) (√(|x| + 1) − 1) + 0.001 x, and a sequence's priority is
    η max |error| + (1 − η) mean |error| over its steps.

    Attributes:
      discount: γ.
      n_step: n.
      double: whether the action is chosen by the network rather than by its target.
      rescale: whether values are learnt under h.
      huber: errors up to this size are squared.
      target: how the target network follows.
      priority_mix: η.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"reward"})
    tells_priority: ClassVar[bool] = True

    discount: float = 0.99
    n_step: int = 1
    double: bool = True
    rescale: bool = False
    huber: float = 1.0
    target: Target = field(default_factory=lambda: Target(every=100))
    priority_mix: float = 0.9

    def __post_init__(self) -> None:
        check_at_least(1, "DQN", n_step=self.n_step)

    @property
    def least_length(self) -> int:
        """Two: a step and its successor."""
        return 2

    def check_model(self, output: ActorCriticOutput) -> None:
        """Refuses models without action values."""
        action_values(output)

    def init(
        self, key: jax.Array, output: ActorCriticOutput, observation: PyTree, action: PyTree
    ) -> dict[str, PyTree]:
        """Returns the number of gradient steps taken; `follow` adds the target network."""
        del key, output, observation, action
        return {"steps": jnp.int32(0)}

    def follow(self, variables: dict[str, PyTree], params: PyTree) -> dict[str, PyTree]:
        """Lets the target network follow the model's parameters."""
        if TARGET_MODEL not in variables:
            return {**variables, TARGET_MODEL: params}
        steps = variables["steps"] + 1
        target = self.target.follow(variables[TARGET_MODEL], params, steps)
        return {**variables, "steps": steps, TARGET_MODEL: target}

    def __call__(
        self,
        output: ActorCriticOutput,
        batch: Batch,
        progress: Progress,
        variables: Any = None,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss, with error (mean |G − Q|), q (mean Q), and the priorities."""
        del progress, variables
        q, target_q = action_values(output), action_values(output.extras["target"])
        best = jnp.argmax(q if self.double else target_q, axis=-1)
        value = of_action(target_q, best)
        known = known_transitions(batch.terminated, batch.truncated)
        returns = n_step_returns(
            batch.reward,
            unscale(value) if self.rescale else value,
            batch.terminated,
            known,
            self.discount,
            self.n_step,
        )
        returns = jax.lax.stop_gradient(scale(returns) if self.rescale else returns)
        chosen = of_action(q, batch.action)
        error = jnp.where(known, returns - chosen, 0.0)
        loss = batch.mean(optax.losses.huber_loss(error, delta=self.huber), where=known)
        size = jnp.abs(error)
        steps = jnp.sum(known, axis=0, dtype=jnp.int32).astype(jnp.float32)
        mean = jnp.sum(size, axis=0) / jnp.maximum(steps, 1.0)
        mix = self.priority_mix
        return loss, {
            "error": batch.mean(size, where=known),
            "q": batch.mean(chosen),
            PRIORITY: mix * jnp.max(size, axis=0) + (1.0 - mix) * mean,
        }


def scale(x: jax.Array) -> jax.Array:
    """Returns h(x) = sign(x) (√(|x| + 1) − 1) + ε x with ε = 0.001 (Pohlen et al. 2018)."""
    return jnp.sign(x) * (jnp.sqrt(jnp.abs(x) + 1.0) - 1.0) + _EPSILON * x


def unscale(x: jax.Array) -> jax.Array:
    """Returns h⁻¹(x), in closed form."""
    root = jnp.sqrt(1.0 + 4.0 * _EPSILON * (jnp.abs(x) + 1.0 + _EPSILON))
    # (root − 1) / 2 ε, without the difference of two numbers that are nearly one.
    size = 2.0 * (jnp.abs(x) + 1.0 + _EPSILON) / (root + 1.0)
    return jnp.sign(x) * (jnp.square(size) - 1.0)


def action_values(output: ActorCriticOutput) -> jax.Array:
    """Returns the model's action values, float32 [..., n].

    Raises:
      JaxactError: it has none.
    """
    if "q" not in output.extras:
        raise JaxactError("Q-learning needs a model of action values, such as QNetwork")
    return output.extras["q"]


def of_action(q: jax.Array, action: jax.Array) -> jax.Array:
    """Returns Q(s, a) of values [..., n] and actions [...]."""
    # A one-hot product rather than a gather: its gradient is no scatter.
    return jnp.sum(q * jax.nn.one_hot(action, q.shape[-1], dtype=q.dtype), axis=-1)
