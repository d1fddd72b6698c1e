"""JaxMARL's grid worlds of two agents in the common loop of JAX systems."""

from __future__ import annotations

from typing import Any

import jax

from jaxact.spaces import Agents, Discrete

PyTree = Any


class JaxMARLWorld:
    """One of its worlds; turnover is in its own `step`, which resets at the same step."""

    def __init__(self, name: str, horizon: int) -> None:
        from jaxmarl.environments import CoinGame, InTheGrid_2p, Overcooked

        match name:
            case "jaxmarl-coin":
                self.env = CoinGame(num_inner_steps=horizon, num_outer_steps=1, cnn=True)
            case "jaxmarl-storm":
                self.env = InTheGrid_2p(num_inner_steps=horizon)
            case "jaxmarl-overcooked":
                self.env = Overcooked(max_steps=horizon)
        self.horizon = horizon
        actions = self.env.action_space(self.env.agents[0]).n
        self.action_space = Agents(Discrete(int(actions)), self.env.num_agents)

    def begin(self, key: jax.Array, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        observation, state = jax.vmap(self.env.reset)(jax.random.split(key, lanes))
        return state, observation

    def age(self, state: PyTree, share: jax.Array) -> PyTree:
        """See `benchmarks.jax_loop.World`."""
        return state.replace(step=(share * self.horizon).astype(state.step.dtype))

    def step(
        self, key: jax.Array, state: PyTree, action: jax.Array
    ) -> tuple[PyTree, PyTree, jax.Array, jax.Array]:
        """See `benchmarks.jax_loop.World`."""
        keys = jax.random.split(key, action.shape[0])
        actions = {agent: action[:, i] for i, agent in enumerate(self.env.agents)}
        observation, state, rewards, dones, _ = jax.vmap(self.env.step)(keys, state, actions)
        reward = sum(rewards[agent] for agent in self.env.agents)
        return state, observation, reward, dones["__all__"]
