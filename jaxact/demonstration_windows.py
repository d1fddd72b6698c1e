"""Demonstrations in training: lanes that stream through whole episodes, window after window.

Lane b of B plays the places b, b + B, b + 2B, … of an endless order of episodes, in which each
epoch (as many places as there are episodes) is a fresh permutation of all of them. Which episode is
at a place is computed from the place alone, so the order is the same on any number of devices, and
every episode is at exactly one place of each epoch, also where B does not divide their number: the
next epoch begins in the middle of a row of lanes. Lanes do not wait for each other: one with
shorter episodes may be in the next epoch already while another is in the one before.

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
    """

    first_step: jax.Array
    observation: dict[str, jax.Array]
    action: PyTree
    valid: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    final_observation: dict[str, jax.Array] | None = None

    @property
    def episodes(self) -> int:
        """N."""
        return int(self.first_step.shape[0]) - 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cursor:
    """Where each lane is; every array is [B], or this device's share of it.

    Attributes:
      epoch: uint32, the epoch of the episode being played.
      place: uint32, its place in that epoch, less than N.
      offset: int32, how many of its steps have been served.
      seed: uint32, of the order of episodes, the same for all lanes.
      lanes: B, over all devices.
    """

    epoch: jax.Array
    place: jax.Array
    offset: jax.Array
    seed: jax.Array
    lanes: int = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Windows:
    """Consecutive steps of every lane; every array is time-major [T, B, ...].

    Attributes:
      observation: named readings that the actions answered to.
      previous_action: the action before each, zeros at the first step of an episode.
      is_first: bool, true at the first step of an episode.
      expert: what was done, and whether it is the demonstrator's own.
      reward: float32.
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
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    seed = jax.random.bits(key, (), jnp.uint32)
    return Cursor(
        epoch=lane // jnp.uint32(episodes),
        place=lane % jnp.uint32(episodes),
        offset=jnp.zeros(lanes, jnp.int32),
        seed=jnp.broadcast_to(seed, (lanes,)),
        lanes=lanes,
    )


def next_windows(data: DemonstrationData, cursor: Cursor, length: int) -> tuple[Windows, Cursor]:
    """Serves the next steps of every lane, across the ends of episodes.

    Args:
      data: what to serve.
      cursor: where the lanes are; may be a share of all lanes.
      length: T (static).

    Returns:
      The windows [T, B], and the cursor for the one after it.
    """
    lanes = cursor.offset.shape[0]
    columns = jnp.arange(lanes, dtype=jnp.int32)
    # Of this episode and the next T, of which no window can see more: which, and its first row.
    epoch, place = _places(cursor, data.episodes, length + 1)
    playing = shuffled(place, data.episodes, hashed(epoch, cursor.seed)).astype(jnp.int32)
    first = data.first_step[playing]
    steps = (data.first_step[playing + 1] - first).at[0].add(-cursor.offset)
    first = first.at[0].add(cursor.offset)
    # Cut off beyond the window, lest the sum should overflow.
    ends = jnp.cumsum(jnp.minimum(steps, length + 1), axis=0, dtype=jnp.int32)
    begins = jnp.concatenate([jnp.zeros((1, lanes), jnp.int32), ends[:-1]])

    # How many episodes have ended before each row, and before the window after this.
    ended = jnp.zeros((length + 1, lanes), jnp.int32).at[ends, columns].add(1, mode="drop")
    turn = jnp.cumsum(ended, axis=0, dtype=jnp.int32)
    rows = jnp.arange(length + 1, dtype=jnp.int32)[:, None]
    step = jnp.take_along_axis(first - begins, turn, axis=0) + rows
    episode = jnp.take_along_axis(playing, turn, axis=0)
    offset = step - data.first_step[episode]
    last, step, is_first = turn[-1], step[:-1], offset[:-1] == 0

    # One row more than the others, for the action before the window.
    before = jnp.concatenate([jnp.maximum(step[:1] - 1, 0), step])
    action = jax.tree.map(lambda x: x[before], data.action)
    observation, valid, reward, terminated, truncated = jax.tree.map(
        lambda x: x[step],
        (data.observation, data.valid, data.reward, data.terminated, data.truncated),
    )
    windows = Windows(
        observation=observation,
        previous_action=jax.tree.map(lambda x: _unless(is_first, x[:-1]), action),
        is_first=is_first,
        expert=ExpertAction(jax.tree.map(lambda x: x[1:], action), valid),
        reward=reward,
        terminated=terminated,
        truncated=truncated,
        episode=episode[:-1],
    )
    cursor = replace(
        cursor, epoch=epoch[last, columns], place=place[last, columns], offset=offset[-1]
    )
    return windows, cursor


def _places(cursor: Cursor, episodes: int, count: int) -> tuple[jax.Array, jax.Array]:
    """Returns epoch and place of the next `count` episodes of each lane, uint32 [count, B].

    They fit for as long as N + T · B is less than 2^32.
    """
    ahead = jnp.arange(count, dtype=jnp.uint32)[:, None] * jnp.uint32(cursor.lanes)
    place = cursor.place + ahead
    return cursor.epoch + place // jnp.uint32(episodes), place % jnp.uint32(episodes)


def _unless(mask: jax.Array, values: jax.Array) -> jax.Array:
    mask = mask.reshape(mask.shape + (1,) * (values.ndim - mask.ndim))
    return jnp.where(mask, jnp.zeros_like(values), values)
