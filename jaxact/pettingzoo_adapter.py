"""Worlds of several agents as PettingZoo's parallel environments.

Which chance an episode has is told in `jaxact.played_episodes`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import jax
import numpy as np
import pettingzoo

from jaxact.errors import JaxactError
from jaxact.gymnasium_spaces import to_jax, to_numpy, to_space
from jaxact.played_episodes import RENDER_MODES, Lane, check_render_mode, programs, seed_word
from jaxact.pomdp import POMDP, PyTree
from jaxact.recording import side_by_side
from jaxact.spaces import Agents, Dict


def to_pettingzoo(
    pomdp: POMDP,
    *,
    seed: int = 0,
    render_mode: str | None = None,
    flatten: bool = False,
    name: str = "jaxact",
) -> pettingzoo.ParallelEnv[str, Any, Any]:
    """Makes a PettingZoo parallel environment of a world of several agents.

    Agents are "agent_0", "agent_1" and so on. Observations are dicts with one array for each
    sensor. An agent's info has what `Step.info` has, of the components of the reward its own.
    Episodes end for all agents together.

    Args:
      pomdp: the world.
      seed: of the episodes until `reset` is given another.
      render_mode: "rgb_array" or None.
      flatten: make every box of the observation a vector.
      name: of the world, in the environment's metadata.

    Raises:
      JaxactError: it is a world of one agent, there is no such mode, or nothing can be pictured.
    """
    return _ParallelPOMDP(pomdp, seed, render_mode, flatten, name)


class _ParallelPOMDP(pettingzoo.ParallelEnv[str, Any, Any]):
    def __init__(
        self, pomdp: POMDP, seed: int, render_mode: str | None, flatten: bool, name: str
    ) -> None:
        space = pomdp.action_space
        if not isinstance(space, Agents):
            raise JaxactError(
                "PettingZoo's parallel environments are for worlds of several agents, and this one "
                "has one without an axis of agents; use to_gymnasium"
            )
        check_render_mode(pomdp, render_mode)
        self._pomdp, self._flatten, self.render_mode = pomdp, flatten, render_mode
        self._seed, self._episode = seed, -1
        self._lane: Lane | None = None
        self._action = space.space
        # Every sensor of such a world has a reading for each agent.
        sensed = pomdp.observation_space.spaces
        self._reading = Dict({n: x.space for n, x in sensed.items() if isinstance(x, Agents)})
        self.metadata = {
            "name": name,
            "render_modes": list(RENDER_MODES),
            "is_parallelizable": True,
        }
        self.possible_agents = [f"agent_{i}" for i in range(space.count)]
        self.agents: list[str] = []
        self.action_spaces = {agent: to_space(self._action) for agent in self.possible_agents}
        self.observation_spaces = {
            agent: to_space(self._reading, flatten) for agent in self.possible_agents
        }

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        return self.action_spaces[agent]

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        if seed is not None:
            self._seed, self._episode = seed, -1
        self._episode += 1
        begin, _, _ = programs(self._pomdp)
        self._lane, observation = begin(seed_word(self._seed), np.int32(self._episode))
        self.agents = list(self.possible_agents)
        return self._each(observation), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        if self._lane is None or not self.agents:
            raise JaxactError("no episode is being played: call reset() first")
        if set(actions) != set(self.agents):
            raise JaxactError(
                f"an action for each of {', '.join(self.agents)} was expected, but there are those "
                f"of {', '.join(actions) or 'nobody'}"
            )
        each = [to_jax(self._action, actions[agent], ()) for agent in self.agents]
        action = jax.tree.map(lambda *leaves: np.stack(leaves), *each)
        _, step, _ = programs(self._pomdp)
        self._lane, result = step(self._lane, action)
        result, info = jax.device_get((result, result.info))
        agents = self.agents
        if result.terminated or result.truncated:
            self.agents = []
        return (
            self._each(result.observation),
            {agent: float(result.reward[i]) for i, agent in enumerate(agents)},
            dict.fromkeys(agents, bool(result.terminated)),
            dict.fromkeys(agents, bool(result.truncated)),
            {
                agent: {n: x[i].item() if x.ndim else x.item() for n, x in info.items()}
                for i, agent in enumerate(agents)
            },
        )

    def render(self) -> Any:
        if self.render_mode is None:
            return None
        if self._lane is None:
            raise JaxactError("no episode is being played: call reset() first")
        _, _, pictures = programs(self._pomdp)
        return side_by_side(list(jax.device_get(pictures(self._lane.state)).values()))

    def _each(self, observation: PyTree) -> dict[str, Any]:
        """Returns everyone's readings."""
        observation = jax.device_get(observation)
        return {
            agent: to_numpy(
                self._reading, jax.tree.map(lambda x, i=i: x[i], observation), self._flatten
            )
            for i, agent in enumerate(self.possible_agents)
        }
