"""Worlds of several agents behind JaxMARL's interface, for algorithms that are written for it.

The interface is that of A. Rutherford et al., "JaxMARL: Multi-Agent RL Environments and Algorithms
in JAX", 2023 (https://arxiv.org/abs/2311.10090). As gymnax's it resets within each step, which
samples an episode for every lane at every step; see `jaxact.gymnax_adapter`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.gymnax_spaces import flattened, to_flat_space, to_space
from jaxact.pomdp import POMDP, PyTree, State
from jaxact.rollout import for_each_agent
from jaxact.spaces import Agents, Dict, Discrete


def to_jaxmarl(pomdp: POMDP, *, name: str = "POMDP", flatten: bool = True) -> JaxMARLEnvironment:
    """Makes an environment with the methods of JaxMARL's `MultiAgentEnv` of a world.

    Args:
      pomdp: the world.
      name: what it is called.
      flatten: whether an agent's observation is one float32 vector, as JaxMARL's wrappers and
        algorithms expect: the sensors' readings in the order of their names, one-hot where they are
        discrete. Without it, it is a dict of the readings.

    Raises:
      JaxactError: it is a world of one agent.
    """
    if not isinstance(pomdp.action_space, Agents):
        raise JaxactError(
            "JaxMARL's environments are for worlds of several agents, and this one has one without "
            "an axis of agents; use to_gymnax"
        )
    return JaxMARLEnvironment(pomdp, name, flatten)


@dataclass(frozen=True)
class JaxMARLEnvironment:
    """A world with the methods of JaxMARL's `MultiAgentEnv`; see `to_jaxmarl`.

    The methods work on one lane. Agents are "agent_0", "agent_1" and so on. Spaces are JaxMARL's
    own, which need it to be installed.
    """

    pomdp: POMDP
    name: str
    flatten: bool

    @property
    def num_agents(self) -> int:
        """How many agents there are."""
        return self.pomdp.num_agents

    @property
    def agents(self) -> list[str]:
        """Their names."""
        return [f"agent_{i}" for i in range(self.num_agents)]

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """The agents by their roles, of which there is but one."""
        return {"agents": self.agents}

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array) -> tuple[dict[str, PyTree], State]:
        """Returns everyone's first observations, and the first state of an episode."""
        state, observation = self.pomdp.reset(key)
        return self._each(observation), state

    @partial(jax.jit, static_argnums=0)
    def step(
        self,
        key: jax.Array,
        state: State,
        actions: Mapping[str, PyTree],
        reset_state: State | None = None,
    ) -> tuple[dict[str, PyTree], State, dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Takes a step, and begins the next episode if it was the last of this one.

        Args:
          key: a PRNG key, the first half of which is the step's and the second the reset's.
          state: the state to step from.
          actions: of each agent.
          reset_state: the state to go on with after the last step; a new episode's by default.

        Returns:
          What `step_env` returns, but that observations and state are those of the next episode if
          this one is over.
        """
        step_key, reset_key = jax.random.split(key)
        observations, after, *rest = self.step_env(step_key, state, actions)
        if reset_state is None:
            fresh = self.reset(reset_key)
        else:
            fresh = self.get_obs(reset_state), reset_state
        finished = rest[1]["__all__"]
        observations, after = jax.tree.map(
            lambda new, old: jax.lax.select(finished, new, old), fresh, (observations, after)
        )
        return observations, after, rest[0], rest[1], rest[2]

    @partial(jax.jit, static_argnums=0)
    def step_env(
        self, key: jax.Array, state: State, actions: Mapping[str, PyTree]
    ) -> tuple[dict[str, PyTree], State, dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Takes a step, and never resets.

        Returns:
          (observations, state, rewards, dones, infos). The first, the third and the fourth are by
          agent; `dones` has "__all__" besides, and episodes end for all together. `infos` has what
          `Step.info` has, "terminated" and "truncated", each [A]: what JaxMARL's algorithms expect.
        """
        each = [actions[agent] for agent in self.agents]
        action = jax.tree.map(
            lambda like, *leaves: jnp.stack([jnp.asarray(x, like.dtype) for x in leaves]),
            self.pomdp.action_space.structure,
            *each,
        )
        state, step = self.pomdp.step(key, state, action)
        rewards = {agent: step.reward[i] for i, agent in enumerate(self.agents)}
        infos = {**step.info, "terminated": step.terminated, "truncated": step.truncated}
        return (
            self._each(step.observation),
            state,
            rewards,
            dict.fromkeys([*self.agents, "__all__"], step.finished),
            {n: for_each_agent(x, step.reward) for n, x in infos.items()},
        )

    @partial(jax.jit, static_argnums=0)
    def get_obs(self, state: State) -> dict[str, PyTree]:
        """Returns everyone's observations of a state."""
        return self._each(self.pomdp.observe(state))

    @partial(jax.jit, static_argnums=0)
    def get_avail_actions(self, state: State) -> dict[str, jax.Array]:
        """Returns which of its n actions each agent may take, bool [n]: always all of them.

        Raises:
          JaxactError: the actions are not discrete.
        """
        del state
        if not isinstance(self._action, Discrete):
            raise JaxactError(f"there is no list of the actions in {self._action}")
        return dict.fromkeys(self.agents, jnp.ones(self._action.n, bool))

    def action_space(self, agent: str) -> Any:
        """Returns JaxMARL's space of an agent's actions.

        Raises:
          JaxactError: JaxMARL is not installed.
        """
        return self.action_spaces[agent]

    def observation_space(self, agent: str) -> Any:
        """Returns JaxMARL's space of an agent's observations.

        Raises:
          JaxactError: JaxMARL is not installed.
        """
        return self.observation_spaces[agent]

    @property
    def action_spaces(self) -> dict[str, Any]:
        """Those of all agents."""
        return dict.fromkeys(self.agents, to_space(self._action, _jaxmarl_spaces()))

    @property
    def observation_spaces(self) -> dict[str, Any]:
        """Those of all agents."""
        convert = to_flat_space if self.flatten else to_space
        return dict.fromkeys(self.agents, convert(self._reading, _jaxmarl_spaces()))

    @property
    def _action(self) -> Any:
        return self.pomdp.action_space.space  # type: ignore[attr-defined]

    @property
    def _reading(self) -> Dict:
        # Every sensor of such a world has a reading for each agent.
        sensed = self.pomdp.observation_space.spaces
        return Dict({n: x.space for n, x in sensed.items() if isinstance(x, Agents)})

    def _each(self, observation: PyTree) -> dict[str, PyTree]:
        """Returns everyone's readings."""
        if self.flatten:
            observation = jax.vmap(partial(flattened, self._reading))(observation)
        return {
            agent: jax.tree.map(lambda x, i=i: x[i], observation)
            for i, agent in enumerate(self.agents)
        }


def _jaxmarl_spaces() -> Any:
    try:
        from jaxmarl.environments import spaces
    except ImportError:
        raise JaxactError(
            "JaxMARL's spaces need jaxmarl, which is not installed: pip install jaxmarl"
        ) from None
    return spaces
