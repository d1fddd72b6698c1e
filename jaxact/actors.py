"""Who acts in a batch of worlds: the task's expert, or a policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.policy import Policy, PolicyMemory
from jaxact.pomdp import POMDP, ExpertAction, PyTree, State
from jaxact.rollout import select

Act = Callable[
    [PyTree, jax.Array, State, dict[str, jax.Array], PyTree], tuple[ExpertAction, PyTree]
]


@dataclass(frozen=True)
class Actor:
    """Pure functions that choose actions for lanes [B].

    Attributes:
      act: (parameters, keys [B], state [B], observation [B, ...], memory) -> (action, memory). The
        action is always one that can be taken; it is `valid` where it is the actor's own choice.
      initial_memory: number of lanes -> memory before the first step of an episode.
    """

    act: Act
    initial_memory: Callable[[int], PyTree]


def expert_actor(pomdp: POMDP) -> Actor:
    """Returns the task's expert; where it abstains, a uniformly random action is taken."""

    def act(
        params: PyTree,
        keys: jax.Array,
        state: State,
        observation: dict[str, jax.Array],
        memory: PyTree,
    ) -> tuple[ExpertAction, PyTree]:
        del params, observation
        expert_keys, random_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        expert = jax.vmap(pomdp.expert)(expert_keys, state)
        random = jax.vmap(pomdp.action_space.sample)(random_keys)
        action = select(expert.valid, expert.action, random)
        return replace(expert, action=action), memory

    return Actor(act, lambda lanes: ())


def policy_actor(pomdp: POMDP, model: Any, greedy: bool) -> Actor:
    """Returns a policy with the given model; its parameters are passed when it acts."""

    def act(
        params: PyTree,
        keys: jax.Array,
        state: State,
        observation: dict[str, jax.Array],
        memory: PyTree,
    ) -> tuple[ExpertAction, PyTree]:
        del state
        policy = Policy(model, params, pomdp.action_space)
        output, model_memory = policy.output(observation, memory)
        if greedy:
            action = output.distribution.mode()
        else:
            action = jax.vmap(lambda d, key: d.sample(key))(output.distribution, keys)
        later = jnp.zeros_like(memory.is_first)
        return ExpertAction(action, ~later), PolicyMemory(model_memory, action, later)

    def initial_memory(lanes: int) -> PyTree:
        return Policy(model, (), pomdp.action_space).initial_memory(lanes)

    return Actor(act, initial_memory)
