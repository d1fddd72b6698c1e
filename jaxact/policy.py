"""A trained model, ready to act."""

from __future__ import annotations

from dataclasses import dataclass, field

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import PyTree
from jaxact.spaces import Space


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PolicyMemory:
    """What a policy carries from one step to the next.

    Attributes:
      model: the model's own memory, [B, ...].
      previous_action: the last action, zeros before the first.
      is_first: bool, no step of the episode has been taken yet.
    """

    model: PyTree
    previous_action: PyTree
    is_first: jax.Array


@dataclass(frozen=True, eq=False)
class Policy:
    """A model with its parameters.

    All methods work on one lane (no leading axis) or on a batch [B, ...], as the memory they are
    given was made by `initial_memory()` or `initial_memory(B)`.

    Attributes:
      model: the actor-critic module.
      params: its parameters.
      action_space: of the world.
    """

    model: nn.Module
    params: PyTree = field(repr=False)
    action_space: Space

    def initial_memory(self, lanes: int | None = None) -> PolicyMemory:
        """Returns the memory at the start of an episode, for one lane or for `lanes` of them."""
        batch = 1 if lanes is None else lanes
        memory = PolicyMemory(
            model=self.model.initial_memory(batch),
            previous_action=jax.tree.map(
                lambda x: jnp.zeros((batch, *x.shape), x.dtype), self.action_space.structure
            ),
            is_first=jnp.ones(batch, bool),
        )
        return _squeeze(memory) if lanes is None else memory

    def output(
        self, observation: dict[str, jax.Array], memory: PolicyMemory
    ) -> tuple[ActorCriticOutput, PyTree]:
        """Returns the action distribution and value, and the model's memory after them."""
        single = memory.is_first.ndim == 0
        if single:
            observation, memory = _expand((observation, memory))
        output, model_memory = self.model.apply(
            self.params, observation, memory.model, memory.previous_action, memory.is_first
        )
        return _squeeze((output, model_memory)) if single else (output, model_memory)

    def act(
        self,
        key: jax.Array,
        observation: dict[str, jax.Array],
        memory: PolicyMemory,
        greedy: bool = False,
    ) -> tuple[PyTree, PolicyMemory]:
        """Chooses an action.

        Args:
          key: one PRNG key (for the whole batch).
          observation: named arrays of one lane or [B, ...].
          memory: from `initial_memory` or the last `act`.
          greedy: take the most likely action instead of a sample.

        Returns:
          The action, and the memory to act with next.
        """
        output, model_memory = self.output(observation, memory)
        action = output.distribution.mode() if greedy else output.distribution.sample(key)
        is_first = jnp.zeros_like(memory.is_first)
        return action, PolicyMemory(model_memory, action, is_first)


def _expand(tree: PyTree) -> PyTree:
    return jax.tree.map(lambda x: x[None], tree)


def _squeeze(tree: PyTree) -> PyTree:
    return jax.tree.map(lambda x: x[0], tree)
