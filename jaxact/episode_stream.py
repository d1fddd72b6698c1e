"""An endless, numbered stream of episodes, played by lanes side by side.

Episode k begins and goes on with keys that are a function of the seed and k alone, and is always
played by lane k mod B, so that it is the same, bit for bit, whenever the stream is begun and
however far the other lanes are. Which episodes are played is decided by their numbers, before
anything is known of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.actors import Actor, expert_actor, policy_actor
from jaxact.caching import cached_by_identity
from jaxact.compaction import for_each_chosen, put_rows
from jaxact.demonstrations import named_leaves
from jaxact.policy import Policy
from jaxact.pomdp import POMDP, PyTree, State
from jaxact.rollout import select
from jaxact.train_state import make_key

# At most. Changing it may change the last bits of what a policy does, and so what is recorded.
LANES = 256
# Steps of each lane between two looks at what they did.
LENGTH = 32
# Folded into the seed, so that no episode is one of training or of evaluation.
RECORDED = 0x6A78_7263

Rows = dict[str, jax.Array]


def stream_keys(seed: int) -> tuple[jax.Array, jax.Array]:
    """Returns the PRNG keys of the sampler's first state and of the stream of episodes."""
    sampler_key, episodes_key = jax.random.split(jax.random.fold_in(make_key(seed), RECORDED))
    return sampler_key, episodes_key


def episode_keys(key: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the PRNG keys of an episode's beginning and of all its steps.

    Step t acts and moves the world with the two halves of `fold_in(step_key, t)`.
    """
    sample_key, step_key = jax.random.split(jax.random.fold_in(key, number))
    return sample_key, step_key


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Lanes:
    """Where the lanes of a stream are, [B].

    Attributes:
      number: int32, of the episode played last or being played.
      over: bool, it has ended.
      state: of the world.
      observation: what is seen there.
      memory: the actor's.
    """

    number: jax.Array
    over: jax.Array
    state: State
    observation: dict[str, jax.Array]
    memory: PyTree


class EpisodeStream:
    """Plays a stream of episodes from one of them on, some steps at a time.

    The sampler stays in its first state.

    Args:
      pomdp: the world.
      policy: who acts; None for the task's expert.
      greedy: whether the policy takes the most likely actions.
      seed: of the stream.
      first: number of the first episode.
      final_observations: whether what is seen after each step is handed out, too.
    """

    def __init__(
        self,
        pomdp: POMDP,
        policy: Policy | None,
        greedy: bool,
        seed: int,
        first: int,
        final_observations: bool,
    ) -> None:
        begin, self._advance = (
            _expert_program(pomdp, final_observations)
            if policy is None
            else _policy_program(pomdp, policy.model, greedy, final_observations)
        )
        sampler_key, self._key = stream_keys(seed)
        self._sampler = jax.jit(pomdp.sampler.init)(sampler_key)
        self._params = () if policy is None else policy.params
        self._lanes = begin(self._sampler, self._key, jnp.int32(first))

    def play(self, limit: int) -> Rows:
        """Takes the next `LENGTH` steps; lanes whose next episode is not below `limit` wait.

        Returns:
          Arrays [LENGTH, lanes, ...] by field name, with "number" and "step" of the episode and
          "active", false where the lane waited and the rest is meaningless.
        """
        limits = jnp.int32(min(limit, 2**31 - 1 - LANES))
        self._lanes, rows = self._advance(
            self._params, self._sampler, self._key, limits, self._lanes
        )
        return rows


@cached_by_identity
def _policy_program(pomdp: POMDP, model: Any, greedy: bool, final: bool) -> tuple[Any, Any]:
    return _program(pomdp, policy_actor(pomdp, model, greedy), final)


@cached_by_identity
def _expert_program(pomdp: POMDP, final: bool) -> tuple[Any, Any]:
    return _program(pomdp, expert_actor(pomdp), final)


def _program(pomdp: POMDP, actor: Actor, final: bool) -> tuple[Any, Any]:
    """Compiles the beginning of a stream, and its next steps."""
    count = pomdp.lanes_at_once(LANES)

    def sample(sampler: PyTree, key: jax.Array, number: jax.Array) -> tuple[State, PyTree]:
        sample_key, _ = episode_keys(key, number)
        state = pomdp.begin(pomdp.sampler.sample(sample_key, sampler))
        return state, pomdp.observe(state)

    def begin(sampler: PyTree, key: jax.Array, first: jax.Array) -> _Lanes:
        lane = jnp.arange(count, dtype=jnp.int32)
        before = first + (lane - first) % count - count
        shapes = jax.eval_shape(sample, sampler, key, first)
        state, observation = jax.tree.map(lambda x: jnp.zeros((count, *x.shape), x.dtype), shapes)
        over = jnp.ones(count, bool)
        return _Lanes(before, over, state, observation, actor.initial_memory(count))

    def advance(
        params: PyTree, sampler: PyTree, key: jax.Array, limit: jax.Array, lanes: _Lanes
    ) -> tuple[_Lanes, Rows]:
        def act(lanes: _Lanes, _: None) -> tuple[_Lanes, Rows]:
            begins = lanes.over & (lanes.number + count < limit)
            number = jnp.where(begins, lanes.number + count, lanes.number)

            def take(places: jax.Array, chosen: jax.Array, now: PyTree) -> tuple[jax.Array, PyTree]:
                new = jax.vmap(lambda number: sample(sampler, key, number))(number[chosen])
                return jnp.zeros_like(places, bool), put_rows(now, places, new)

            now = (lanes.state, lanes.observation)
            state, observation = for_each_chosen(begins, now, take, share=8)
            memory = select(begins, actor.initial_memory(count), lanes.memory)

            step_keys = jax.vmap(lambda number: episode_keys(key, number)[1])(number)
            keys = jax.vmap(lambda key, t: jax.random.split(jax.random.fold_in(key, t)))(
                step_keys, state.steps
            )
            act_keys, world_keys = jnp.moveaxis(keys, 1, 0)
            chosen, memory = actor.act(params, act_keys, state, observation, memory)
            after, step = jax.vmap(pomdp.step)(world_keys, state, chosen.action)
            active = begins | ~lanes.over
            rows = {
                "number": number,
                "step": state.steps,
                "active": active,
                **named_leaves("observation", observation),
                **named_leaves("action", chosen.action),
                "valid": chosen.valid,
                "reward": step.reward,
                "terminated": step.terminated,
                "truncated": step.truncated,
                "success": step.success,
                **named_leaves("reward_terms", step.reward_terms),
            }
            if chosen.policy is not None:
                rows["policy"] = chosen.policy
            if final:
                rows |= named_leaves("final_observation", step.observation)
            over = jnp.where(active, step.finished, True)
            return _Lanes(number, over, after, step.observation, memory), rows

        return jax.lax.scan(act, lanes, None, LENGTH)

    return jax.jit(begin), jax.jit(advance)
