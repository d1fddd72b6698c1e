"""Acting: lanes of worlds, a queue of fresh episodes for each, and the scan that steps them.

A lane is one world. Each lane holds a short queue of episodes sampled ahead; a lane that has
finished takes its next one before it acts again, and when any queue is empty one scalar branch
replaces what was taken from all of them. So no level is thrown away, no episode is served twice,
and episode k of lane b is a pure function of the seed, b and k, whatever the number of devices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.compaction import anywhere, for_each_chosen, put_rows
from jaxact.models.output import ActorCriticOutput
from jaxact.pomdp import POMDP, Episode, ExpertAction, FinishedEpisodes, PyTree, State, Step

QUEUE_LENGTH = 8
# With a sampler that learns the queue lasts for one rollout, see `rollout`. Worlds outside of JAX
# cannot begin an episode before the one before is over.
SHORTEST_QUEUE_LENGTH = 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EpisodeQueue:
    """Episodes sampled ahead, leading axes [B] or [B, Q]; episode k is in place k mod Q.

    Attributes:
      key: PRNG key [B] of each lane's stream of episodes.
      served: int32 [B], how many of the stream were taken.
      drawn: int32 [B], how many of the stream were sampled; the last drawn - served are waiting.
      episodes: [B, Q].
      observations: first observation of each, its arrays laid out as vectors, [B, Q, n]. XLA would
        else keep pictures in one layout, gather from another one, and copy them all at every step.
    """

    key: jax.Array
    served: jax.Array
    drawn: jax.Array
    episodes: Episode
    observations: dict[str, jax.Array]

    @property
    def length(self) -> int:
        """Q, the most episodes that wait for a lane."""
        return int(jax.tree.leaves(self.observations)[0].shape[1])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lanes:
    """Worlds in progress, leading axis [B] everywhere.

    Attributes:
      key: PRNG key of each lane.
      state: where each episode stands.
      observation: what is seen there.
      queue: episodes to come.
      memory: the policy's memory.
      previous_action: the last action (zeros before the first).
      is_first: bool, true where the next step is the first of a new episode: state and observation
        are then those of the one before, at its end.
      episode_return: float32, sum of rewards so far; of several agents the mean.
      episode_terms: the same for each of the reward's named components.
    """

    key: jax.Array
    state: State
    observation: dict[str, jax.Array]
    queue: EpisodeQueue
    memory: PyTree
    previous_action: PyTree
    is_first: jax.Array
    episode_return: jax.Array
    episode_terms: dict[str, jax.Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trajectory:
    """What happened in a rollout, time-major [T, B, ...].

    Where there are A agents, observations, actions, log-probabilities, values, rewards, advice and
    `forced` have an axis of agents after that of lanes, [T, B, A, ...].

    Attributes:
      observation, previous_action, is_first: what the policy was given.
      action: what was done; log_prob: its log-probability; value: the value estimated.
      step: reward, flags and the observation reached (an episode's final one at its end).
      memory: the policy's memory after the step.
      expert: the expert's advice, None unless asked for.
      forced: bool, true where the expert's action was taken in place of the policy's.
      finished: how episodes ended, with `task` None unless asked for, and no `mean_error` yet.
      episode_terms: named components of the return of the episodes that ended.
    """

    observation: dict[str, jax.Array]
    previous_action: PyTree
    is_first: jax.Array
    action: PyTree
    log_prob: jax.Array
    value: jax.Array
    step: Step
    memory: PyTree
    expert: ExpertAction | None
    forced: jax.Array
    finished: FinishedEpisodes
    episode_terms: dict[str, jax.Array]


def refill(
    pomdp: POMDP, sampler_state: PyTree, queue: EpisodeQueue, only: jax.Array | None = None
) -> EpisodeQueue:
    """Samples the episodes that each lane's queue lacks.

    Args:
      pomdp: the world.
      sampler_state: of its sampler.
      queue: episodes to come.
      only: bool [B], which lanes' queues; None for all.
    """
    lanes, length = queue.served.shape[0], queue.length
    served = queue.served[:, None]
    index = served + (jnp.arange(length, dtype=jnp.int32) - served) % length
    absent, drawn = index >= queue.drawn[:, None], queue.served + length
    if only is not None:
        absent, drawn = absent & only[:, None], jnp.where(only, drawn, queue.drawn)
    lacking = absent.reshape(-1)

    def sample(key: jax.Array, index: jax.Array) -> tuple[Episode, dict[str, jax.Array]]:
        episode = pomdp.sampler.sample(jax.random.fold_in(key, index), sampler_state)
        observation = pomdp.observe(pomdp.begin(episode))
        return episode, jax.tree.map(jnp.ravel, observation)

    def draw(places: jax.Array, rows: jax.Array, waiting: PyTree) -> tuple[jax.Array, PyTree]:
        new = jax.vmap(sample)(queue.key[rows // length], index.reshape(-1)[rows])
        return jnp.zeros_like(places, bool), put_rows(waiting, places, new)

    waiting = _merge_axes((queue.episodes, queue.observations))
    waiting = for_each_chosen(lacking, waiting, draw, share=16)
    episodes, observations = jax.tree.map(lambda x: x.reshape(lanes, length, *x.shape[1:]), waiting)
    return EpisodeQueue(queue.key, queue.served, drawn, episodes, observations)


def _merge_axes(tree: PyTree) -> PyTree:
    """Makes one of the first two axes."""
    return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]), tree)


def turn_over(
    pomdp: POMDP,
    sampler_state: PyTree,
    queue: EpisodeQueue,
    finished: jax.Array,
    state: State,
    observation: dict[str, jax.Array],
) -> tuple[EpisodeQueue, State, dict[str, jax.Array]]:
    """Gives each finished lane its next episode.

    Args:
      pomdp: the world.
      sampler_state: for refilling.
      queue: episodes to come.
      finished: bool [B].
      state: where the lanes stand [B].
      observation: what is seen there [B, ...].

    Returns:
      The queue, states and observations to go on with.
    """

    def runs_dry(queue: EpisodeQueue) -> jax.Array:
        return anywhere(jnp.any(finished & (queue.served >= queue.drawn)))

    # A loop of at most one pass, which works in place. Under `vmap` (over seeds or draws) all
    # queues are refilled as soon as one is dry; were it decided for each run by itself, what is
    # sampled for the others would be thrown away and sampled again.
    only = None if pomdp.environment.max_lanes is None else finished
    queue = jax.lax.while_loop(
        runs_dry, lambda queue: refill(pomdp, sampler_state, queue, only), queue
    )
    state, observation = _take(pomdp, queue, finished, state, observation)
    queue = replace(queue, served=queue.served + finished.astype(jnp.int32))
    return queue, state, observation


def _take(
    pomdp: POMDP,
    queue: EpisodeQueue,
    finished: jax.Array,
    state: State,
    observation: dict[str, jax.Array],
) -> tuple[State, dict[str, jax.Array]]:
    """Puts the next episode of each finished lane, and what is first seen of it, in its place."""
    waiting = _merge_axes((queue.episodes, queue.observations))
    place = queue.served % queue.length

    def take(places: jax.Array, rows: jax.Array, now: PyTree) -> tuple[jax.Array, PyTree]:
        index = rows * queue.length + place[rows]
        episode, vectors = jax.tree.map(lambda x: x[index], waiting)
        first_observation = jax.tree.map(
            lambda x, like: x.reshape(*index.shape, *like.shape[1:]), vectors, observation
        )
        new = (jax.vmap(pomdp.begin)(episode), first_observation)
        return jnp.zeros_like(places, bool), put_rows(now, places, new)

    return for_each_chosen(finished, (state, observation), take)


def select(mask: jax.Array, on_true: PyTree, on_false: PyTree) -> PyTree:
    """Chooses between two trees of [B, ...] by a mask [B]."""
    return jax.tree.map(
        lambda a, b: jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - mask.ndim)), a, b),
        on_true,
        on_false,
    )


def mean_of_agents(x: jax.Array, lead: int) -> jax.Array:
    """Returns the mean over agents of an array that has an axis of them after `lead` others."""
    return jnp.mean(x, axis=lead) if x.ndim > lead else x


def for_each_agent(x: jax.Array, like: jax.Array) -> jax.Array:
    """Gives what is the same for all agents, [...], the shape of what each has, [...] or [..., A].

    An array that has none is returned as it is.
    """
    return x if x.ndim == like.ndim else jnp.broadcast_to(x[..., None], like.shape)


def start_lanes(
    pomdp: POMDP, sampler_state: PyTree, model: Any, keys: jax.Array, queue_length: int
) -> Lanes:
    """Returns lanes whose first episodes are about to begin; none is sampled yet.

    Args:
      pomdp: the world.
      sampler_state: of its sampler.
      model: has `initial_memory(lanes)`.
      keys: a PRNG key for each lane, [B].
      queue_length: episodes sampled ahead for each lane.
    """
    lanes = keys.shape[0]
    stream_keys, lane_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
    none = jnp.zeros(lanes, jnp.int32)
    episode = jax.eval_shape(pomdp.sampler.sample, stream_keys[0], sampler_state)
    state = jax.eval_shape(pomdp.begin, episode)
    observation = jax.eval_shape(pomdp.observe, state)
    action = pomdp.action_space.structure
    _, step = jax.eval_shape(pomdp.step, lane_keys[0], state, action)
    vectors = jax.eval_shape(lambda tree: jax.tree.map(jnp.ravel, tree), observation)

    def nothing_like(tree: PyTree, *lead: int) -> PyTree:
        return jax.tree.map(lambda x: jnp.zeros((*lead, *x.shape), x.dtype), tree)

    queue = EpisodeQueue(
        key=stream_keys,
        served=none,
        drawn=none,
        episodes=nothing_like(episode, lanes, queue_length),
        observations=nothing_like(vectors, lanes, queue_length),
    )
    return Lanes(
        key=lane_keys,
        state=nothing_like(state, lanes),
        observation=nothing_like(observation, lanes),
        queue=queue,
        memory=model.initial_memory(lanes),
        previous_action=nothing_like(action, lanes),
        is_first=jnp.ones(lanes, bool),
        episode_return=jnp.zeros(lanes, jnp.float32),
        episode_terms={name: jnp.zeros(lanes, jnp.float32) for name in step.reward_terms},
    )


def rollout(
    pomdp: POMDP,
    policy: Callable[..., tuple[ActorCriticOutput, PyTree]],
    sampler_state: PyTree,
    lanes: Lanes,
    length: int,
    *,
    query_expert: bool = False,
    teacher_forcing: float | jax.Array = 0.0,
    keep_tasks: bool = False,
) -> tuple[Lanes, Trajectory]:
    """Steps all lanes `length` times.

    With a sampler that learns, what was sampled ahead in earlier rollouts is forgotten, so that
    each episode is drawn under the sampler's state in the rollout in which it begins. When a queue
    was refilled last depends on its neighbours, and so on which lanes share a device.

    Args:
      pomdp: the world.
      policy: (observation, memory, previous_action, is_first) -> (output, memory), on [B, ...].
      sampler_state: of the world's sampler.
      lanes: where to begin.
      length: T.
      query_expert: whether the expert is asked at every step.
      teacher_forcing: probability that a valid expert action replaces the policy's.
      keep_tasks: whether `finished.task` is recorded.

    Returns:
      The lanes where they then stand, and what happened, [T, B, ...].
    """

    def act(lanes: Lanes, _: None) -> tuple[Lanes, Trajectory]:
        keys = jnp.moveaxis(jax.vmap(lambda k: jax.random.split(k, 5))(lanes.key), 1, 0)
        key, action_keys, world_keys, expert_keys, forcing_keys = keys
        queue, state, observation = turn_over(
            pomdp, sampler_state, lanes.queue, lanes.is_first, lanes.state, lanes.observation
        )
        going_on = jnp.where(lanes.is_first, 0.0, jnp.float32(1))
        output, memory = policy(observation, lanes.memory, lanes.previous_action, lanes.is_first)
        action = jax.vmap(lambda distribution, key: distribution.sample(key))(
            output.distribution, action_keys
        )
        expert, forced = None, jnp.zeros(output.value.shape, bool)
        if query_expert:
            expert = jax.vmap(pomdp.expert)(expert_keys, state)
            shape = expert.valid.shape[1:]
            uniform = jax.vmap(lambda k: jax.random.uniform(k, shape, jnp.float32))(forcing_keys)
            forced = expert.valid & (uniform < teacher_forcing)
            action = select(forced, expert.action, action)
        state, step = jax.vmap(pomdp.step)(world_keys, state, action)

        episode_return = lanes.episode_return * going_on + mean_of_agents(step.reward, 1)
        episode_terms = {
            name: total * going_on + mean_of_agents(step.reward_terms[name], 1)
            for name, total in lanes.episode_terms.items()
        }
        transition = Trajectory(
            observation=observation,
            previous_action=lanes.previous_action,
            is_first=lanes.is_first,
            action=action,
            log_prob=output.distribution.log_prob(action),
            value=output.value,
            step=step,
            memory=memory,
            expert=expert,
            forced=forced,
            finished=FinishedEpisodes(
                mask=step.finished,
                success=step.success,
                episode_return=episode_return,
                length=state.steps,
                task=state.task if keep_tasks else None,
                origin=state.origin,
                mean_error=None,
            ),
            episode_terms=episode_terms,
        )
        lanes = Lanes(
            key=key,
            state=state,
            observation=step.observation,
            queue=queue,
            memory=memory,
            previous_action=action,
            is_first=step.finished,
            episode_return=episode_return,
            episode_terms=episode_terms,
        )
        return lanes, transition

    if pomdp.sampler.learns:
        lanes = replace(lanes, queue=replace(lanes.queue, drawn=lanes.queue.served))
    return jax.lax.scan(act, lanes, None, length)


def next_values(
    policy: Callable[..., tuple[ActorCriticOutput, PyTree]], trajectory: Trajectory
) -> jax.Array:
    """Returns the value of each state stepped to, float32 [T, B] (or [T, B, A]); of an episode's
    final state where it was truncated, and zero where it terminated.

    Within an episode it is the value estimated at the next step. Final observations are passed
    through the policy one round at a time: the last step of every lane, then each lane's latest
    truncation not yet done. Most rollouts need one or two rounds of B observations.
    """
    step = trajectory.step
    length, lanes = step.terminated.shape
    values = jnp.concatenate([trajectory.value[1:], jnp.zeros_like(trajectory.value[:1])])
    pending = (step.truncated & ~step.terminated).at[-1].set(True)
    columns = jnp.arange(lanes)

    def one_round(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        pending, values = carry
        row = length - 1 - jnp.argmax(pending[::-1], axis=0)
        observation, memory, action = jax.tree.map(
            lambda x: x[row, columns], (step.observation, trajectory.memory, trajectory.action)
        )
        output, _ = policy(observation, memory, action, jnp.zeros(lanes, bool))
        known = values[row, columns]
        value = jnp.where(for_each_agent(pending[row, columns], known), output.value, known)
        return pending.at[row, columns].set(False), values.at[row, columns].set(value)

    _, values = jax.lax.while_loop(lambda carry: jnp.any(carry[0]), one_round, (pending, values))
    return jnp.where(for_each_agent(step.terminated, values), 0.0, values)
