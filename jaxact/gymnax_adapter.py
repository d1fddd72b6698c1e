"""Worlds behind gymnax's interface, for libraries written for it, such as Rejax and PureJaxRL.

gymnax resets within each step. Under `vmap` that samples an episode for every lane at every step,
of which nearly all are thrown away: an empty room takes half as long again, a level of BabyAI's
GoToLocal dozens of times as long as its steps alone. `jaxact.rollout`, which trains jaxact's own
policies, draws from queues of episodes instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxact import spaces
from jaxact.errors import JaxactError
from jaxact.gymnax_spaces import flattened, to_flat_space, to_space
from jaxact.pomdp import POMDP, PyTree, State


def to_gymnax(
    pomdp: POMDP, *, name: str = "POMDP", flatten: bool = False, joint_done: bool = False
) -> GymnaxEnvironment:
    """Makes an environment with gymnax's methods of a world.

    Args:
      pomdp: the world.
      name: what it is called.
      flatten: whether an observation is one float32 vector, for libraries that expect a box: the
        sensors' readings in the order of their names, one-hot where they are discrete.
      joint_done: whether `step` returns one flag `done`, as up to gymnax 0.0.9 and as Rejax 0.1 and
        PureJaxRL take it, rather than `terminated` and `truncated`.

    Raises:
      JaxactError: the world is one of several agents, or simulated outside of JAX.
    """
    pomdp.check_single_agent("gymnax environments are")
    pomdp.check_in_jax("gymnax environments are")
    return GymnaxEnvironment(pomdp, name, flatten, joint_done)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GymnaxParams:
    """What gymnax calls the environment's parameters.

    Attributes:
      max_steps_in_episode: int32, truncates episodes whose own horizon is farther away.
    """

    max_steps_in_episode: int | jax.Array = 2**31 - 1


@dataclass(frozen=True)
class GymnaxEnvironment:
    """A world with gymnax's methods; see `to_gymnax`.

    The methods work on one lane, and without `params` on the default ones. Spaces are gymnax's own,
    which need it to be installed.
    """

    pomdp: POMDP
    name: str
    flatten: bool
    joint_done: bool

    @property
    def default_params(self) -> GymnaxParams:
        """Leaves every episode its own horizon."""
        return GymnaxParams()

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array, params: GymnaxParams | None = None) -> tuple[PyTree, State]:
        """Returns the first observation and state of an episode."""
        state, observation = self.pomdp.reset(key)
        limit = (params or self.default_params).max_steps_in_episode
        horizon = jnp.minimum(state.horizon, jnp.asarray(limit, jnp.int32))
        return self._observed(observation), replace(state, horizon=horizon)

    @partial(jax.jit, static_argnums=0)
    def step(
        self, key: jax.Array, state: State, action: PyTree, params: GymnaxParams | None = None
    ) -> tuple[Any, ...]:
        """Takes a step, and begins the next episode if it was the last of this one.

        Returns:
          (observation, state, reward, terminated, truncated, info), or with `joint_done`
          (observation, state, reward, done, info). Observation and state are those of the next
          episode if this one is over; `info` has what `Step.info` has, "terminated", "truncated",
          and in "final_observation" what was observed before any reset.
        """
        step_key, reset_key = jax.random.split(key)
        action = jax.tree.map(
            lambda x, like: jnp.asarray(x, like.dtype), action, self.pomdp.action_space.structure
        )
        after, step = self.pomdp.step(step_key, state, action)
        final = self._observed(step.observation)
        fresh = self.reset(reset_key, params)
        observation, state = jax.tree.map(
            lambda new, old: jax.lax.select(step.finished, new, old), fresh, (final, after)
        )
        flags = {"terminated": step.terminated, "truncated": step.truncated}
        info = {**step.info, **flags, "final_observation": final}
        done = (step.finished,) if self.joint_done else tuple(flags.values())
        return observation, state, step.reward, *done, info

    @property
    def num_actions(self) -> int:
        """The number of discrete actions, or of a box's entries.

        Raises:
          JaxactError: the actions are neither.
        """
        match self.pomdp.action_space:
            case spaces.Discrete(n):
                return n
            case spaces.Box(shape=shape):
                return math.prod(shape)
        raise JaxactError(f"there is no one number of actions in {self.pomdp.action_space}")

    def action_space(self, params: GymnaxParams | None = None) -> Any:
        """Returns gymnax's space of the actions.

        Raises:
          JaxactError: gymnax is not installed.
        """
        del params
        return to_space(self.pomdp.action_space, _gymnax())

    def observation_space(self, params: GymnaxParams | None = None) -> Any:
        """Returns gymnax's space of the observations.

        Raises:
          JaxactError: gymnax is not installed.
        """
        del params
        space = self.pomdp.observation_space
        if not self.flatten:
            return to_space(space, _gymnax())
        return to_flat_space(space, _gymnax())

    def _observed(self, observation: PyTree) -> PyTree:
        if not self.flatten:
            return observation
        return flattened(self.pomdp.observation_space, observation)


def _gymnax() -> Any:
    try:
        from gymnax.environments import spaces as gymnax_spaces
    except ImportError:
        raise JaxactError(
            "gymnax's spaces need gymnax, which is not installed: pip install gymnax"
        ) from None
    return gymnax_spaces
