"""Playing against what one was some updates ago.

A pool keeps snapshots of the policy's parameters, and each episode draws its opponents from it, as
do T. Bansal et al., "Emergent Complexity via Multi-Agent Competition", 2018
(https://arxiv.org/abs/1710.03748), who draw from all or the latest past selves uniformly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.game import Opponent, rows_of, space_of
from jaxact.opponents import WithOpponents, make_game, world_of
from jaxact.policy import Policy
from jaxact.pomdp import POMDP, Episode, FinishedEpisodes, PyTree
from jaxact.spaces import Agents
from jaxact.train_state import make_key


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Snapshots:
    """The pool.

    Attributes:
      params: of the policy, leading axis [N]; the k-th snapshot is in place k mod N.
      taken: int32 scalar, how many snapshots there have been.
      updates: int32 scalar, how many updates there have been.
      inner: the state of the world's sampler.
    """

    params: PyTree
    taken: jax.Array
    updates: jax.Array
    inner: PyTree


@dataclass(frozen=True)
class PastSelves(WithOpponents):
    """Draws the episodes of a game, and for each opponent a snapshot of the policy to play it.

    Before the first update and after every `every` more a snapshot is taken; the latest `size` are
    kept. Those of an episode are drawn when it begins, each as likely, and stay to its end. Before
    there is any, as in evaluation, the parameters are untrained ones, always the same.

    How many snapshots there have been is reported as "train/sampler/snapshots".

    Attributes:
      game: whose opponents' policies have no parameters.
      size: N, the most snapshots that are kept.
      every: updates from one snapshot to the next.

    Raises:
      JaxactError: a number out of its bounds.
    """

    size: int = 8
    every: int = 50

    def __post_init__(self) -> None:
        for name in ("size", "every"):
            if getattr(self, name) < 1:
                raise JaxactError(f"{name} must be at least 1, got {getattr(self, name)}")

    @property
    def learns(self) -> bool:
        """True: what was sampled ahead is drawn anew when there is another snapshot."""
        return True

    def check_model(self, model: nn.Module) -> None:
        """Refuses to play against a policy of another model."""
        own = self.game.opponents[0].policy.model
        if model != own:
            raise JaxactError(
                f"past selves are of the model that is trained, {model}, but the game was made for "
                f"{own}; give against_past_selves the experiment's model"
            )

    def init(self, key: jax.Array) -> Snapshots:
        """Returns a pool of untrained parameters, the same for every key."""
        untrained = self._untrained()
        return Snapshots(
            params=jax.tree.map(lambda x: jnp.broadcast_to(x, (self.size, *x.shape)), untrained),
            taken=jnp.int32(0),
            updates=jnp.int32(0),
            inner=super().init(key),
        )

    def follow(self, sampler_state: Snapshots, params: PyTree) -> Snapshots:
        """Takes a snapshot if it is time for one."""
        due = sampler_state.updates % self.every == 0
        place = jnp.where(due, sampler_state.taken % self.size, self.size)
        return replace(
            sampler_state,
            params=jax.tree.map(
                lambda pool, now: pool.at[place].set(now, mode="drop"), sampler_state.params, params
            ),
            taken=sampler_state.taken + due.astype(jnp.int32),
            updates=sampler_state.updates + 1,
        )

    def sample(self, key: jax.Array, sampler_state: Snapshots) -> Episode:
        """Draws an episode of the world, and who plays each opponent."""
        episode_key, *keys = jax.random.split(key, 1 + len(self.game.opponents))
        episode = self.game.pomdp.sampler.sample(episode_key, sampler_state.inner)
        held = jnp.clip(sampler_state.taken, 1, self.size)
        drawn = [jax.random.randint(each, (), 0, held, jnp.int32) for each in keys]
        params = tuple(jax.tree.map(lambda x, i=i: x[i], sampler_state.params) for i in drawn)
        return replace(episode, environment=self.game.begin(episode, params))

    def update(self, sampler_state: Snapshots, finished: FinishedEpisodes) -> Snapshots:
        """Lets the world's sampler learn, if it does."""
        if not self.game.pomdp.sampler.learns:
            return sampler_state
        return replace(sampler_state, inner=super().update(sampler_state.inner, finished))

    def metrics(self, sampler_state: Snapshots) -> Mapping[str, jax.Array]:
        """How many snapshots there have been, and what the world's sampler reports."""
        taken = sampler_state.taken.astype(jnp.float32)
        return {**super().metrics(sampler_state.inner), "snapshots": taken}

    def _untrained(self) -> PyTree:
        policy, learners = self.game.opponents[0].policy, self.game.learners
        observation = rows_of(self.game.pomdp.observation_space.zeros(), learners)
        memory = policy.initial_memory(1)
        return policy.model.init(
            make_key(0),
            jax.tree.map(lambda x: x[None], observation),
            memory.model,
            memory.previous_action,
            memory.is_first,
        )


def against_past_selves(
    pomdp: POMDP,
    model: nn.Module,
    *,
    learners: tuple[int, ...] = (0,),
    size: int = 8,
    every: int = 50,
    greedy: bool = False,
) -> POMDP:
    """Makes of a world of several agents one in which past selves of the learners play the others.

    All other agents, in their order, are parted into groups as large as that of the learners, and
    each group is played by a past self of its own. The world should look alike to all agents. If
    there is one learner, the world and the model are those of a single agent, see
    `jaxact.opponents.against`.

    Each lane carries its opponents' parameters from an episode's beginning to its end, in memory
    and in checkpoints, and works with them: fit for small networks, or for few lanes.

    Args:
      pomdp: the world.
      model: that of the experiment, for the learners.
      learners: the agents that learn.
      size, every: see `PastSelves`.
      greedy: whether past selves take their most likely actions instead of samples.

    Raises:
      JaxactError: see `jaxact.opponents.against`; or the others do not divide into such groups.
    """
    if not isinstance(pomdp.action_space, Agents):
        raise JaxactError(
            "past selves are for worlds of several agents, and this one has one without an axis of "
            "agents"
        )
    everyone = range(pomdp.num_agents)
    for agent in learners:
        if agent not in everyone:
            raise JaxactError(f"there is no agent {agent}: they are 0 to {len(everyone) - 1}")
    others = [agent for agent in everyone if agent not in learners]
    width = len(learners)
    if not learners or not others or len(others) % width:
        raise JaxactError(
            f"past selves of {width} learner(s) cannot play {len(others)} other agent(s): the "
            "others must be as many, or a multiple of it"
        )
    policy = Policy(model, None, space_of(pomdp.action_space, learners))
    groups = [tuple(others[i : i + width]) for i in range(0, len(others), width)]
    game = make_game(pomdp, [Opponent(agents, policy, greedy) for agents in groups])
    return world_of(game, PastSelves(game, size, every))
