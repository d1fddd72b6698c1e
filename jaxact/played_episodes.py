"""Episodes that others' code plays from Python, step by step.

All chance in episode e after a reset with seed s is from `fold_in(jaxact.make_key(s), e)`, which is
split into the key of its reset and that of its steps; into the latter step t folds t.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, PyTree, State, Step
from jaxact.train_state import make_key

RENDER_MODES = ("rgb_array",)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lane:
    """An episode in progress.

    Attributes:
      seed: uint32 scalar.
      episode: int32 scalar, its number since the seed was set.
      key: PRNG key of its steps.
      state: where it stands.
    """

    seed: jax.Array
    episode: jax.Array
    key: jax.Array
    state: State


def begin_episode(pomdp: POMDP, seed: jax.Array, episode: jax.Array) -> tuple[Lane, PyTree]:
    """Returns the episode of that number, and its first observation."""
    reset_key, step_key = jax.random.split(jax.random.fold_in(make_key(seed), episode))
    state, observation = pomdp.reset(reset_key)
    return Lane(seed, episode, step_key, state), observation


def step_episode(pomdp: POMDP, lane: Lane, action: PyTree) -> tuple[Lane, Step]:
    """Returns the episode after the action, and what came of it."""
    key = jax.random.fold_in(lane.key, lane.state.steps)
    state, step = pomdp.step(key, lane.state, action)
    return replace(lane, state=state), step


@functools.lru_cache(16)
def programs(pomdp: POMDP) -> tuple[Any, Any, Any]:
    """Compiles the beginning of an episode, a step of it, and its pictures."""
    begin = functools.partial(begin_episode, pomdp)
    return jax.jit(begin), jax.jit(functools.partial(step_episode, pomdp)), jax.jit(pomdp.pictures)


def seed_word(seed: int) -> np.uint32:
    """Returns a seed's lowest 32 bits."""
    return np.uint32(seed % 2**32)


def check_render_mode(pomdp: POMDP, render_mode: str | None) -> None:
    """Refuses what cannot be rendered.

    Raises:
      JaxactError: no such mode, or no sensor can be pictured.
    """
    if render_mode is None:
        return
    if render_mode not in RENDER_MODES:
        raise unknown("render mode", render_mode, RENDER_MODES)
    if not pomdp.has_pictures:
        raise JaxactError("there is nothing to render: no sensor has a method picture")
