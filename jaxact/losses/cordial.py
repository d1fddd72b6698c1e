"""Keeps several agents from actions that do not go together."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.losses.base import Batch, Loss, Progress
from jaxact.models.output import ActorCriticOutput
from jaxact.team_distributions import joint_log_probs

_INDIVIDUAL, _TOGETHER = 1, 2


@dataclass(frozen=True)
class Cordial(Loss):
    """CORDIAL: −½ (mean of log p over individual joint actions + mean over those done together).

    The means are over the cells of the coordination matrix, whatever was done (U. Jain et al. 2020,
    https://arxiv.org/abs/2007.04979, section 4.3). Its weight there falls from 1 to that of the
    entropy bonus, β, over 5000 · (1 − β) episodes, as `Stage.weights` can say with
    `Linear(1.0, β, steps)`; and there is no entropy bonus beside it. Policies that are products of
    the agents' own have it too.

    Attributes:
      observation: name of the reading, uint8 [n, …, n] for each agent, of what each joint action
        would be: 0 uncoordinated, 1 individual, 2 together.
    """

    observation: str = "coordination"

    def __call__(
        self, output: ActorCriticOutput, batch: Batch, progress: Progress
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Returns the loss; invalid_probability, that of uncoordinated joint actions; and
        total_variation, between the joint policy and the product of its marginals.
        """
        del progress
        kinds = batch.observation[self.observation]
        agents = kinds.ndim - batch.terminated.ndim
        cells = tuple(range(-agents, 0))
        table = joint_log_probs(output.distribution, agents)
        kinds = kinds[..., ::agents, *(slice(None),) * agents]

        def over(kind: int) -> jax.Array:
            held = (kinds == kind).astype(jnp.float32)
            count = jnp.maximum(jnp.sum(held, axis=cells), 1.0)
            return jnp.sum(table * held, axis=cells) / count

        joint = jnp.exp(table)
        product = jnp.ones_like(joint)
        for i in cells:
            others = tuple(j for j in cells if j != i)
            product = product * jnp.sum(joint, axis=others, keepdims=True)
        invalid = jnp.where((kinds == _INDIVIDUAL) | (kinds == _TOGETHER), 0.0, joint)

        def mean(values: jax.Array) -> jax.Array:
            return batch.mean(jnp.repeat(values, agents, axis=-1))

        return mean(-0.5 * (over(_INDIVIDUAL) + over(_TOGETHER))), {
            "invalid_probability": mean(jnp.sum(invalid, axis=cells)),
            "total_variation": mean(0.5 * jnp.sum(jnp.abs(joint - product), axis=cells)),
        }
