"""A grid world in which the agent is given an object after its first observation.

BabyAI's levels that begin with full hands put the object there when the first observation is
already made: it shows the object on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import GridWorld, at_index, cell_index, with_index
from envs_jax.minigrid.state import GridState

NOWHERE = (-1, -1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LateHandsState(GridState):
    """A grid world whose next step begins with putting an object into the agent's hands.

    Attributes:
      given: int32[2], (x, y) of that object; `NOWHERE` when there is none (any more).
    """

    given: jax.Array

    @classmethod
    def of(cls, state: GridState, given: jax.Array) -> LateHandsState:
        """Returns `state` with an object to be given to the agent."""
        parts = {field.name: getattr(state, field.name) for field in fields(GridState)}
        return cls(**parts, given=given)


@dataclass(frozen=True)
class LateHandsWorld(GridWorld):
    """`GridWorld` on a `LateHandsState`.

    Source: `PutNext.reset` of minigrid 3.2.0, with `start_carrying`.
    """

    def step(self, key: jax.Array, state: GridState, action: jax.Array) -> GridState:
        """Returns the state after one action; `key` is not used."""
        assert isinstance(state, LateHandsState)
        gives = state.given[0] >= 0
        cell = cell_index(jnp.maximum(state.given, 0), self.height)
        tile, mark = at_index(state.tiles, cell), at_index(state.marks, cell)
        floor = jnp.where(gives, jnp.uint8(tiles.EMPTY_TILE), tile)
        state = replace(
            state,
            tiles=with_index(state.tiles, cell, floor),
            marks=with_index(state.marks, cell, jnp.where(gives, jnp.uint16(0), mark)),
            carrying=jnp.where(gives, tile, state.carrying),
            carrying_mark=jnp.where(gives, mark, state.carrying_mark),
            given=jnp.full_like(state.given, NOWHERE[0]),
        )
        return super().step(key, state, action)
