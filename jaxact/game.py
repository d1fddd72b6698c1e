"""A world of several agents, its task and those who play some of them, as one environment.

See `jaxact.opponents`, which makes of it a world for the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from jaxact.policy import Policy
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree
from jaxact.spaces import Agents, Space

T = TypeVar("T")


@dataclass(frozen=True)
class Opponent:
    """Who plays some of the agents.

    Attributes:
      agents: which ones.
      policy: of these agents together; of one agent, without an axis of them, if it is one; or of
        all agents of the world, whose other actions are then not taken. Without parameters if each
        episode brings its own.
      greedy: whether it takes its most likely actions.
    """

    agents: tuple[int, ...]
    policy: Policy
    greedy: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GameState:
    """How a game stands.

    Attributes:
      environment: the world's state.
      task: its task's.
      readings: what all agents see, by the sensor's name [A, ...].
      memories: of each opponent.
      params: of each opponent's policy where the episode brings them, else ().
      outcome: what the task said of the last step; zeros before the first.
    """

    environment: PyTree
    task: PyTree
    readings: dict[str, jax.Array]
    memories: tuple[PyTree, ...]
    params: tuple[PyTree, ...]
    outcome: Outcome


@dataclass(frozen=True)
class Game(Environment):
    """A world with its task, in which opponents play all agents but the learners.

    Attributes:
      pomdp: the world; its sampler is not used.
      opponents: who plays whom.
    """

    pomdp: POMDP
    opponents: tuple[Opponent, ...]

    @property
    def learners(self) -> tuple[int, ...]:
        """The agents that no opponent plays."""
        taken = {agent for opponent in self.opponents for agent in opponent.agents}
        return tuple(agent for agent in range(self.pomdp.num_agents) if agent not in taken)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Those of the world."""
        return self.pomdp.environment.action_names

    @property
    def action_space(self) -> Space:
        """An action for each learner; without an axis if there is one."""
        return space_of(self.pomdp.action_space, self.learners)

    def begin(self, episode: Episode, params: tuple[PyTree, ...]) -> GameState:
        """Returns the first state of an episode of the world.

        Args:
          episode: of the world.
          params: see `GameState`.
        """
        world, task = episode.environment, episode.task
        action = self.pomdp.action_space.zeros()
        key = jax.random.key(0)
        _, outcome = jax.eval_shape(self._play, key, world, task, action)
        return GameState(
            environment=world,
            task=task,
            readings=self.pomdp.observe(self.pomdp.begin(episode)),
            memories=tuple(opponent.policy.initial_memory() for opponent in self.opponents),
            params=params,
            outcome=jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), outcome),
        )

    def step(self, key: jax.Array, state: GameState, action: PyTree) -> GameState:
        """Lets opponents choose their actions, and returns what follows on those of all."""
        world_key, *keys = jax.random.split(key, 1 + len(self.opponents))
        each = zip(keys, self.opponents, state.params, state.memories, strict=True)
        played = [self._choose(*given, state.readings) for given in each]
        actions = [action, *(chosen for chosen, _ in played)]
        groups = [self.learners, *(opponent.agents for opponent in self.opponents)]

        def together(like: jax.ShapeDtypeStruct, *parts: jax.Array) -> jax.Array:
            whole = jnp.zeros(like.shape, like.dtype)
            for agents, part in zip(groups, parts, strict=True):
                rows = jnp.asarray(part, like.dtype).reshape(len(agents), *like.shape[1:])
                whole = whole.at[jnp.asarray(agents)].set(rows)
            return whole

        everyones = jax.tree.map(together, self.pomdp.action_space.structure, *actions)
        memories = tuple(
            replace(memory, previous_action=everyones) if self._of_all(opponent) else memory
            for opponent, (_, memory) in zip(self.opponents, played, strict=True)
        )
        (world, task), outcome = self._play(world_key, state.environment, state.task, everyones)
        reached = self.pomdp.begin(Episode(world, task, jnp.int32(0)))
        readings = self.pomdp.observe(reached)
        return GameState(world, task, readings, memories, state.params, outcome)

    def _play(
        self, key: jax.Array, world: PyTree, task: PyTree, action: PyTree
    ) -> tuple[tuple[PyTree, PyTree], Outcome]:
        after = self.pomdp.environment.step(key, world, action)
        task, outcome = self.pomdp.task.step(task, world, action, after)
        return (after, task), outcome

    def _choose(
        self,
        key: jax.Array,
        opponent: Opponent,
        params: PyTree,
        memory: PyTree,
        readings: dict[str, jax.Array],
    ) -> tuple[PyTree, PyTree]:
        policy, observation = opponent.policy, readings
        if policy.params is None:
            policy = replace(policy, params=params)
        if not self._of_all(opponent):
            observation = rows_of(readings, opponent.agents)
        action, memory = policy.act(key, observation, memory, opponent.greedy)
        return rows_of(action, opponent.agents) if self._of_all(opponent) else action, memory

    def _of_all(self, opponent: Opponent) -> bool:
        return opponent.policy.action_space == self.pomdp.action_space


def space_of(space: Space, agents: tuple[int, ...]) -> Space:
    """Returns the space of what some agents have of what all have."""
    assert isinstance(space, Agents)
    return replace(space, count=len(agents)) if len(agents) > 1 else space.space


def rows_of(tree: T, agents: tuple[int, ...]) -> T:
    """Returns some agents' part of arrays [A, ...]; without the axis of a single one."""
    index: Any = jnp.asarray(agents) if len(agents) > 1 else agents[0]
    return jax.tree.map(lambda x: x[index], tree)
