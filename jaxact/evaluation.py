"""Evaluation on held-out episodes: each is played once, from its first state to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.actors import Actor, expert_actor, policy_actor
from jaxact.caching import cached_by_identity
from jaxact.compaction import anywhere
from jaxact.policy import Policy
from jaxact.pomdp import POMDP, Listed, PyTree, State
from jaxact.rollout import mean_of_agents, select
from jaxact.simulators import explained
from jaxact.statistics import confidence_interval, mean_interval
from jaxact.train_state import make_key

# Episodes played side by side, of one policy and of several together; more are played in turns.
MAX_LANES = 1000
MAX_LANES_OF_SEVERAL = 20_000
# Folded into the seed, so that no episode drawn here is one that was trained on.
HELD_OUT = 0x6A78_6576


@dataclass(frozen=True)
class Evaluation:
    """How each of N episodes went; arrays are [N].

    Attributes:
      success: bool.
      episode_return: float32, sum of rewards; of several agents the mean.
      length: int32, steps.
      metrics: named float32 task metrics at the episode's end, and components of the return; the
        return of each of several agents.
      kinds: bool by name, of which of the sampler's kinds the episode was.
    """

    success: np.ndarray
    episode_return: np.ndarray
    length: np.ndarray
    metrics: dict[str, np.ndarray]
    kinds: dict[str, np.ndarray] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Returns means with 95 % confidence intervals, as plain numbers.

        The success rate's interval is Wilson's, the others' Student's. Kinds of which there was
        no episode are left out.
        """
        values = {"return": self.episode_return, "length": self.length, **self.metrics}
        return {
            "episodes": len(self.success),
            "success": _success_rate(self.success),
            **{
                name: {"mean": float(np.mean(x)), "interval": list(mean_interval(x))}
                for name, x in values.items()
            },
            **{
                f"kinds/{name}/success": _success_rate(self.success[mask])
                for name, mask in self.kinds.items()
                if mask.any()
            },
        }


def _success_rate(success: np.ndarray) -> dict[str, Any]:
    successes, episodes = int(success.sum()), len(success)
    interval = list(confidence_interval(successes, episodes))
    return {"mean": successes / episodes, "interval": interval}


def evaluate_policy(
    pomdp: POMDP, policy: Policy, episodes: int = 1000, *, seed: int = 0, greedy: bool = False
) -> Evaluation:
    """Plays a policy on `episodes` held-out episodes.

    The same seed gives the same episodes to every policy. Of a list of episodes (`pomdp.Listed`)
    the first are played, each once and in order, whatever the seed, and no more than there are.
    """
    player = _compiled_policy_player(pomdp, policy.model, greedy)
    return _evaluate(pomdp, player, policy.params, episodes, seed, MAX_LANES)


def evaluate_expert(pomdp: POMDP, episodes: int = 1000, *, seed: int = 0) -> Evaluation:
    """Plays the task's expert; where it abstains, a uniformly random action is taken.

    Raises:
      JaxactError: the task has no expert.
    """
    player = _expert_player(pomdp)
    return _evaluate(pomdp, player, (), episodes, seed, MAX_LANES)


def evaluate_policies(
    pomdp: POMDP, player: Player, params: PyTree, episodes: int = 1000, *, seed: int = 0
) -> list[Evaluation]:
    """Plays several policies of one model on the same held-out episodes, side by side.

    Args:
      pomdp: the world.
      player: `policy_player(...)` under `vmap` over its first argument, and compiled.
      params: of N policies, leading axis [N].
      episodes: how many held-out episodes each of them plays.
      seed: of the episodes; they are those that `evaluate_policy` plays.

    Returns:
      An evaluation for each policy.

    Raises:
      JaxactError: the world is simulated outside of JAX.
    """
    pomdp.check_in_jax("evaluations of several policies at once are")
    policies = jax.tree.leaves(params)[0].shape[0]
    lanes = max(1, min(MAX_LANES, MAX_LANES_OF_SEVERAL // policies))
    joined = _evaluate(pomdp, player, params, episodes, seed, lanes)
    parts = {f.name: getattr(joined, f.name) for f in fields(Evaluation)}
    return [Evaluation(**jax.tree.map(lambda x, i=i: x[i], parts)) for i in range(policies)]


def held_out_keys(seed: int, episodes: int) -> tuple[jax.Array, jax.Array]:
    """Returns the PRNG keys [N] of held-out episodes' beginnings, and [N] of all their steps.

    Episode i has the same keys however many there are.
    """
    keys = jax.random.split(jax.random.fold_in(make_key(seed), HELD_OUT), episodes)
    reset_keys, step_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
    return reset_keys, step_keys


def held_out_lanes(pomdp: POMDP, seed: int, episodes: int) -> tuple[jax.Array, jax.Array]:
    """Returns what held-out episodes begin from, see `begin_held_out`, and their steps' keys.

    Returns:
      PRNG keys [N], or int32 [N] where held-out episodes are listed; and PRNG keys [N].
    """
    sampler = pomdp.sampler.held_out
    if isinstance(sampler, Listed):
        episodes = min(episodes, sampler.count)
    reset_keys, step_keys = held_out_keys(seed, episodes)
    if isinstance(sampler, Listed):
        return jnp.arange(episodes, dtype=jnp.int32), step_keys
    return reset_keys, step_keys


def begin_held_out(pomdp: POMDP, beginning: jax.Array) -> tuple[State, dict[str, jax.Array]]:
    """Returns the first state and observation of a held-out episode.

    Args:
      pomdp: the world.
      beginning: a PRNG key or, where held-out episodes are listed, an int32 index.
    """
    pomdp = replace(pomdp, sampler=pomdp.sampler.held_out)
    if not isinstance(pomdp.sampler, Listed):
        return pomdp.reset(beginning)
    state = pomdp.begin(pomdp.sampler.listed(beginning, pomdp.sampler.init(make_key(0))))
    return state, pomdp.observe(state)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Play:
    """Episodes being played, [B]."""

    state: State
    observation: dict[str, jax.Array]
    memory: PyTree
    done: jax.Array
    success: jax.Array
    episode_return: jax.Array
    length: jax.Array
    metrics: dict[str, jax.Array]
    kinds: dict[str, jax.Array]


Player = Callable[[PyTree, jax.Array, jax.Array], _Play]


def policy_player(pomdp: POMDP, model: Any, greedy: bool) -> Player:
    """Makes (parameters, beginnings [B], step keys [B]) -> finished episodes, to be compiled.

    Beginnings and keys are those of `held_out_lanes`.
    """
    return _player(pomdp, policy_actor(pomdp, model, greedy))


@cached_by_identity
def _compiled_policy_player(pomdp: POMDP, model: Any, greedy: bool) -> Player:
    return jax.jit(policy_player(pomdp, model, greedy))


@cached_by_identity
def _expert_player(pomdp: POMDP) -> Player:
    return jax.jit(_player(pomdp, expert_actor(pomdp)))


def _player(pomdp: POMDP, actor: Actor) -> Player:
    held_out, agents = pomdp.sampler.held_out, pomdp.num_agents

    def play_episodes(params: PyTree, beginnings: jax.Array, step_keys: jax.Array) -> _Play:
        lanes = beginnings.shape[0]
        state, observation = jax.vmap(partial(begin_held_out, pomdp))(beginnings)
        action = jax.vmap(pomdp.action_space.sample)(step_keys)
        _, shape = jax.eval_shape(jax.vmap(pomdp.step), step_keys, state, action)
        zeros = jnp.zeros(lanes, jnp.float32)
        names = [f"task/{n}" for n in shape.metrics] + [f"reward/{n}" for n in shape.reward_terms]
        names += [f"agents/{i}/return" for i in range(agents) if agents > 1]
        first = _Play(
            state=state,
            observation=observation,
            memory=actor.initial_memory(lanes),
            done=jnp.zeros(lanes, bool),
            success=jnp.zeros(lanes, bool),
            episode_return=zeros,
            length=jnp.zeros(lanes, jnp.int32),
            metrics={name: zeros for name in names},
            kinds=dict(held_out.kinds(state.origin)),
        )

        def advance(play: _Play) -> _Play:
            split = jax.vmap(lambda key, t: jax.random.split(jax.random.fold_in(key, t)))
            act_keys, world_keys = jnp.moveaxis(split(step_keys, play.state.steps), 1, 0)
            chosen, memory = actor.act(params, act_keys, play.state, play.observation, play.memory)
            state, step = jax.vmap(pomdp.step)(world_keys, play.state, chosen.action)
            metrics = {f"task/{n}": x for n, x in step.metrics.items()}
            for name, reward in step.reward_terms.items():
                total = play.metrics[f"reward/{name}"]
                metrics[f"reward/{name}"] = total + mean_of_agents(reward, 1)
            for i in range(agents) if agents > 1 else ():
                name = f"agents/{i}/return"
                metrics[name] = play.metrics[name] + step.reward[:, i]
            after = _Play(
                state=state,
                observation=step.observation,
                memory=memory,
                done=step.finished,
                success=step.success,
                episode_return=play.episode_return + mean_of_agents(step.reward, 1),
                length=state.steps,
                metrics=metrics,
                kinds=play.kinds,
            )
            return select(play.done, play, after)

        return jax.lax.while_loop(lambda play: anywhere(~jnp.all(play.done)), advance, first)

    return play_episodes


@explained()
def _evaluate(
    pomdp: POMDP, player: Player, params: PyTree, episodes: int, seed: int, max_lanes: int
) -> Evaluation:
    beginnings, step_keys = held_out_lanes(pomdp, seed, episodes)
    episodes, max_lanes = len(beginnings), pomdp.lanes_at_once(max_lanes)
    # Batches of one size, so that one program serves all; what the last one lacks is played again
    # and left out.
    turns = -(-episodes // max_lanes)
    lanes = -(-episodes // turns)
    parts = []
    for turn in range(turns):
        chosen = np.arange(turn * lanes, (turn + 1) * lanes) % episodes
        parts.append(player(params, beginnings[chosen], step_keys[chosen]))

    results = [(p.success, p.episode_return, p.length, p.metrics, p.kinds) for p in parts]
    joined = jax.tree.map(
        lambda *xs: np.concatenate([np.asarray(x) for x in xs], axis=-1)[..., :episodes], *results
    )
    return Evaluation(*joined)
