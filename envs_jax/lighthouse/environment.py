"""The dynamics of a lighthouse: a walk on a line or in a square."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.pomdp import Environment
from jaxact.spaces import Discrete


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LighthouseState:
    """The agent, and what it has come near to.

    Attributes:
      position: int32[dim], each −R … R.
      nearest: int32[2^dim], for each corner the least distance that the agent has been from it,
        along the axis on which it was further.
      last_action: int32 scalar, 2 · dim before the first.
    """

    position: jax.Array
    nearest: jax.Array
    last_action: jax.Array


def corners(dim: int) -> np.ndarray:
    """Returns int32[2^dim, dim], the direction of each corner from the centre: −1 or 1."""
    return np.array(list(itertools.product((-1, 1), repeat=dim)), np.int32)


def distances(position: jax.Array, radius: int) -> jax.Array:
    """Returns int32[2^dim], how far each corner is along the axis on which it is further."""
    places = radius * corners(position.shape[0])
    return jnp.max(jnp.abs(jnp.asarray(places) - position), axis=1)


@dataclass(frozen=True)
class Lighthouse(Environment):
    """A line (`dim` 1) or square (2) of 2 R + 1 cells a side, with R the `radius`.

    Action i < dim goes one cell forward along axis i, action dim + i one back; the border holds the
    agent where it is. Nothing is random.
    """

    dim: int
    radius: int

    @property
    def action_names(self) -> tuple[str, ...]:
        """Forward along each axis, then back."""
        if self.dim == 1:
            return ("right", "left")
        return ("down", "right", "up", "left")

    @property
    def action_space(self) -> Discrete:
        """Two actions for each axis."""
        return Discrete(2 * self.dim)

    def step(self, key: jax.Array, state: LighthouseState, action: jax.Array) -> LighthouseState:
        """Returns the state after one action; `key` is not used."""
        del key
        action = jnp.asarray(action, jnp.int32)
        axis = jnp.arange(self.dim, dtype=jnp.int32) == action % self.dim
        move = jnp.where(action < self.dim, 1, -1) * axis.astype(jnp.int32)
        position = jnp.clip(state.position + move, -self.radius, self.radius)
        nearest = jnp.minimum(state.nearest, distances(position, self.radius))
        return LighthouseState(position, nearest, action)
