"""Demonstrations in training: lanes that stream through whole episodes, window after window.

There is an endless order of episodes, in which each epoch (as many places as there are episodes) is
a fresh permutation of all of them. A lane whose episode has ended takes the next place that nobody
has taken, lanes that do so at the same step in their order. So every episode has begun once before
any begins a second time, however unequal their lengths and whether or not the number of lanes
divides that of episodes. Which episode is at a place is computed from the place alone, and who
takes which from where all lanes are, so both are the same on any number of devices.

A lane goes on where the last window ended, in the middle of an episode too. A recurrent model's
memory is carried from window to window as it is from rollout to rollout, and reset at `is_first`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp

from jaxact.index_shuffle import hashed, shuffled
from jaxact.pomdp import ExpertAction, PyTree


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DemonstrationData:
    """All steps of N episodes, one after the other [S, ...]; the same on every device.

    Attributes:
      first_step: int32 [N + 1], where each episode begins, and S.
      observation: named readings that the actions answered to.
      action: what was done.
      valid: bool, whether the action is the demonstrator's own; elsewhere it was drawn at random
        because the expert abstained.
      reward: float32.
      terminated: bool.
      truncated: bool.
      final_observation: what was seen after the last step of each episode [N, ...]; None if that
        was not recorded.
      reward_terms: the reward's named components, float32; none if they were not recorded.
      policy: float32 [S, n], probabilities of the demonstrator's n discrete actions; None if they
        were not recorded.
    """

    first_step: jax.Array
    observation: dict[str, jax.Array]
    action: PyTree
    valid: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    final_observation: dict[str, jax.Array] | None = None
    reward_terms: dict[str, jax.Array] = field(default_factory=dict)
    policy: jax.Array | None = None

    @property
    def episodes(self) -> int:
        """N."""
        return int(self.first_step.shape[0]) - 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cursor:
    """Where each lane is; every array is [B], or this device's share of it.

    Attributes:
      episode: int32, which is being played.
      offset: int32, how many of its steps have been served.
      epoch: uint32, of the next free place; like the two below the same for all lanes.
      place: uint32, the next free place in that epoch, less than N.
      seed: uint32, of the order of episodes.
    """

    episode: jax.Array
    offset: jax.Array
    epoch: jax.Array
    place: jax.Array
    seed: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Windows:
    """Consecutive steps of every lane; every array is time-major [T, B, ...].

    Attributes:
      observation: named readings that the actions answered to.
      previous_action: the action before each, zeros at the first step of an episode.
      is_first: bool, true at the first step of an episode.
      expert: what was done, whether it is the demonstrator's own, and the demonstrator's policy
        where that was recorded.
      reward: float32.
      reward_terms: its named components, as far as they were recorded.
      terminated: bool.
      truncated: bool.
      episode: int32, which of the data's episodes the step is of; where one was truncated,
        `data.final_observation[name][episode]` is what to bootstrap from.
    """

    observation: dict[str, jax.Array]
    previous_action: PyTree
    is_first: jax.Array
    expert: ExpertAction
    reward: jax.Array
    reward_terms: dict[str, jax.Array]
    terminated: jax.Array
    truncated: jax.Array
    episode: jax.Array


def start_cursor(episodes: int, lanes: int, key: jax.Array) -> Cursor:
    """Returns the cursor before the first window.

    Args:
      episodes: N, how many episodes the data has.
      lanes: B, over all devices.
      key: PRNG key of the order of episodes.
    """
    seed = jax.random.bits(key, (), jnp.uint32)
    none = jnp.zeros(lanes, jnp.int32)
    nowhere = none.astype(jnp.uint32)
    first = Cursor(none, none, nowhere, nowhere, jnp.broadcast_to(seed, (lanes,)))
    return replace(_after(first, episodes, lanes), episode=_coming(first, episodes, lanes))


def next_windows(
    data: DemonstrationData, cursor: Cursor, length: int, axis_name: str | None = None
) -> tuple[Windows, Cursor]:
    """Serves the next steps of every lane, across the ends of episodes.

    Args:
      data: what to serve.
      cursor: where the lanes are; of this device's lanes.
      length: T (static).
      axis_name: the device axis along which there are the other lanes, None on a single device.

    Returns:
      The windows [T, B], and the cursor for the one after it.
    """
    episode, offset = cursor.episode, cursor.offset
    if axis_name is not None:
        # Who takes which place depends on all lanes: each device works it out for all of them.
        episode, offset = jax.lax.all_gather((episode, offset), axis_name, axis=0, tiled=True)
    lanes = episode.shape[0]
    coming = _coming(cursor, data.episodes, length * lanes)

    def serve(
        now: tuple[jax.Array, jax.Array, jax.Array], _: None
    ) -> tuple[tuple[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        episode, step, taken = now
        over = step + 1 == data.first_step[episode + 1]
        turn = taken + jnp.cumsum(over, dtype=jnp.int32)
        next_episode = jnp.where(over, coming[turn - 1], episode)
        next_step = jnp.where(over, data.first_step[next_episode], step + 1)
        return (next_episode, next_step, turn[-1]), (episode, step)

    now = (episode, data.first_step[episode] + offset, jnp.int32(0))
    (last, following, taken), (episode, step) = jax.lax.scan(serve, now, None, length)
    offset = following - data.first_step[last]
    if axis_name is not None:
        own = cursor.offset.shape[0]
        begin = jax.lax.axis_index(axis_name) * own
        last, offset, episode, step = (
            jax.lax.dynamic_slice_in_dim(x, begin, own, axis=-1)
            for x in (last, offset, episode, step)
        )
    is_first = step == data.first_step[episode]

    # One row more than the others, for the action before the window.
    before = jnp.concatenate([jnp.maximum(step[:1] - 1, 0), step])
    action = jax.tree.map(lambda x: x[before], data.action)
    observation, valid, policy, reward, reward_terms, terminated, truncated = jax.tree.map(
        lambda x: x[step],
        (
            data.observation,
            data.valid,
            data.policy,
            data.reward,
            data.reward_terms,
            data.terminated,
            data.truncated,
        ),
    )
    windows = Windows(
        observation=observation,
        previous_action=jax.tree.map(lambda x: _unless(is_first, x[:-1]), action),
        is_first=is_first,
        expert=ExpertAction(jax.tree.map(lambda x: x[1:], action), valid, policy),
        reward=reward,
        reward_terms=reward_terms,
        terminated=terminated,
        truncated=truncated,
        episode=episode,
    )
    cursor = _after(cursor, data.episodes, taken)
    return windows, replace(cursor, episode=last, offset=offset)


def _coming(cursor: Cursor, episodes: int, count: int) -> jax.Array:
    """Returns the episodes at the next `count` free places, int32 [count].

    The places fit for as long as N + count is less than 2^32.
    """
    place = cursor.place[0] + jnp.arange(count, dtype=jnp.uint32)
    key = hashed(cursor.epoch[0] + place // jnp.uint32(episodes), cursor.seed[0])
    return shuffled(place % jnp.uint32(episodes), episodes, key).astype(jnp.int32)


def _after(cursor: Cursor, episodes: int, taken: jax.Array | int) -> Cursor:
    """Returns the cursor with so many more places taken."""
    place = cursor.place + jnp.asarray(taken, jnp.uint32)
    epoch = cursor.epoch + place // jnp.uint32(episodes)
    return replace(cursor, epoch=epoch, place=place % jnp.uint32(episodes))


def _unless(mask: jax.Array, values: jax.Array) -> jax.Array:
    mask = mask.reshape(mask.shape + (1,) * (values.ndim - mask.ndim))
    return jnp.where(mask, jnp.zeros_like(values), values)
