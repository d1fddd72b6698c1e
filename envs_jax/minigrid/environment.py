"""The dynamics of a grid world: one step function for every MiniGrid and BabyAI id."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, GridState
from jaxact.pomdp import Environment
from jaxact.spaces import Discrete

LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(7)
NUM_ACTIONS = 7


def _mask(*kinds: int) -> int:
    return sum(1 << kind for kind in kinds)


# Sets of tile types, see `is_kind`: what the agent may stand on, what it may take up, and doors.
PASSABLE = _mask(
    tiles.EMPTY, tiles.FLOOR, tiles.OPEN_DOOR, tiles.OPEN_LOCKED_DOOR, tiles.GOAL, tiles.LAVA
)
PORTABLE = _mask(tiles.KEY, tiles.BALL, tiles.BOX)
OPEN_DOORS = _mask(tiles.OPEN_DOOR, tiles.OPEN_LOCKED_DOOR)
DOORS = OPEN_DOORS | _mask(tiles.CLOSED_DOOR, tiles.LOCKED_DOOR)


def is_kind(code: jax.Array, kinds: int) -> jax.Array:
    """Returns whether the packed tile `code` has one of the types in the bit set `kinds`."""
    return (jnp.int32(kinds) >> (code & tiles.TYPE_MASK).astype(jnp.int32)) & 1 == 1


def heading(direction: jax.Array) -> jax.Array:
    """Returns the int32[2] unit step (x, y) that leads forward in `direction`."""
    axes = jnp.stack([direction & 1 ^ 1, direction & 1])
    return axes * (1 - (direction & 2))


def cell_index(position: jax.Array, height: int) -> jax.Array:
    """Returns the int32 index, in a plane laid out flat, of cell `position` (int32[2])."""
    return (position[0] + PADDING) * (height + 2 * PADDING) + position[1] + PADDING


def front_index(state: GridState, height: int) -> jax.Array:
    """Returns the int32 index, in a plane laid out flat, of the cell that the agent faces."""
    return cell_index(state.position + heading(state.direction), height)


def at_index(plane: jax.Array, index: jax.Array) -> jax.Array:
    """Reads cells of a plane, by their indices in the plane laid out flat."""
    return plane.reshape(-1)[index]


def with_index(plane: jax.Array, index: jax.Array, value: jax.Array) -> jax.Array:
    """Returns the plane with other values in some cells, by their indices in it laid out flat."""
    return plane.reshape(-1).at[index].set(value).reshape(plane.shape)


@dataclass(frozen=True)
class GridWorld(Environment):
    """MiniGrid's dynamics on a grid of `width` × `height` cells, its walls included.

    Actions are MiniGrid's seven: left, right, forward, pickup, drop, toggle, done (numbers outside
    0 … 6 do nothing). Nothing is random and nothing ends here: goals and lava are passable cells,
    their meaning is a task's business. Source: `MiniGridEnv.step` of minigrid 3.2.0.

    With `pickup_toggles` the action pickup does what toggle does, as in MiniGrid's Memory worlds.
    """

    width: int
    height: int
    pickup_toggles: bool = False

    @property
    def action_names(self) -> tuple[str, ...]:
        """Left, right, forward, pickup, drop, toggle, done."""
        return ("left", "right", "forward", "pickup", "drop", "toggle", "done")

    @property
    def action_space(self) -> Discrete:
        """Seven actions."""
        return Discrete(NUM_ACTIONS)

    def step(self, key: jax.Array, state: GridState, action: jax.Array) -> GridState:
        """Returns the state after one action; `key` is not used."""
        del key
        action = jnp.asarray(action, jnp.int32)
        if self.pickup_toggles:
            action = jnp.where(action == PICKUP, TOGGLE, action)
        front = front_index(state, self.height)
        tile, mark = at_index(state.tiles, front), at_index(state.marks, front)
        empty_handed = state.carrying == 0

        moves = (action == FORWARD) & is_kind(tile, PASSABLE)
        picks = (action == PICKUP) & is_kind(tile, PORTABLE) & empty_handed
        drops = (action == DROP) & is_kind(tile, _mask(tiles.EMPTY)) & ~empty_handed
        toggles = action == TOGGLE
        unboxes = toggles & is_kind(tile, _mask(tiles.BOX))

        new_tile = jnp.where(toggles, _toggled(tile, mark, state.carrying), tile)
        new_tile = jnp.where(picks, jnp.uint8(tiles.EMPTY_TILE), new_tile)
        new_tile = jnp.where(drops, state.carrying, new_tile)
        new_mark = jnp.where(picks | unboxes, jnp.uint16(0), mark)
        new_mark = jnp.where(drops, state.carrying_mark, new_mark)
        held = jnp.where(drops, jnp.uint8(0), state.carrying)
        held_mark = jnp.where(drops, jnp.uint16(0), state.carrying_mark)
        turn = (action == RIGHT).astype(jnp.int32) - (action == LEFT).astype(jnp.int32)
        return replace(
            state,
            tiles=with_index(state.tiles, front, new_tile),
            marks=with_index(state.marks, front, new_mark),
            position=state.position + moves.astype(jnp.int32) * heading(state.direction),
            direction=(state.direction + turn) & 3,
            carrying=jnp.where(picks, tile, held),
            carrying_mark=jnp.where(picks, mark, held_mark),
        )


def _toggled(tile: jax.Array, mark: jax.Array, carrying: jax.Array) -> jax.Array:
    """Returns what a toggle makes of `tile`: doors swing or unlock, boxes give up their contents.

    A lock opens at once with a key of its colour, which stays in hand, and never shuts again.
    """
    kind, color = tile & tiles.TYPE_MASK, tile & (255 - tiles.TYPE_MASK)
    has_key = carrying == (color | tiles.KEY)
    locked = (kind == tiles.LOCKED_DOOR) | (kind == tiles.OPEN_LOCKED_DOOR)
    opens = (kind == tiles.CLOSED_DOOR) | (locked & has_key)
    result = jnp.where(opens, color | tiles.OPEN_DOOR, tile)
    result = jnp.where(kind == tiles.OPEN_DOOR, color | tiles.CLOSED_DOOR, result)
    content = (mark >> CONTENTS_SHIFT).astype(jnp.uint8)
    key = (content - 1) << tiles.COLOR_SHIFT | tiles.KEY
    revealed = jnp.where(content == 0, jnp.uint8(tiles.EMPTY_TILE), key)
    return jnp.where(kind == tiles.BOX, revealed, result)
