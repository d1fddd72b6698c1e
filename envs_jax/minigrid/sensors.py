"""What the agent senses: its partial view, its heading and its mission.

The view is computed on packed tiles, one byte a cell, and decoded at the very end. View cell
(vx, vy) counts vx from left to right and vy from far (0) to the agent's own row; the agent stands
in the middle of that row, looking towards vy = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, tiles
from envs_jax.minigrid.environment import is_kind
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.errors import JaxactError
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Box, Discrete

VIEW_SIZE = 7

_OPAQUE = 1 << tiles.WALL | 1 << tiles.CLOSED_DOOR | 1 << tiles.LOCKED_DOOR


@dataclass(frozen=True)
class PackedImageSensor(Sensor):
    """The agent's view as packed tiles, uint8[view_size, view_size], indexed [vx, vy].

    `tiles.decode` turns it into MiniGrid's image. What is carried shows in the agent's own cell;
    cells out of sight are 0. `view_size` is odd, from 3 to 7.

    Source: `MiniGridEnv.gen_obs_grid` and `Grid.process_vis` of minigrid 3.2.0.
    """

    width: int
    height: int
    view_size: int = VIEW_SIZE
    see_through_walls: bool = False

    def __post_init__(self) -> None:
        if self.view_size not in range(3, PADDING + 2, 2):
            raise JaxactError(
                f"view_size must be odd, from 3 to {PADDING + 1}; got {self.view_size!r}"
            )

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the view."""
        return Box(0, 255, (self.view_size, self.view_size), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the view."""
        del task_state
        view = self._ahead(state)
        hand = jnp.where(state.carrying == 0, jnp.uint8(tiles.EMPTY_TILE), state.carrying)
        shown = view.at[self.view_size // 2, self.view_size - 1].set(hand)
        if self.see_through_walls:
            return shown
        return jnp.where(_visible(view), shown, jnp.uint8(tiles.UNSEEN))

    def _ahead(self, state: GridState) -> jax.Array:
        """Returns the square in front of the agent, turned so that it looks towards vy = 0."""
        size = self.view_size
        plane = state.tiles.reshape(self.width + 2 * PADDING, self.height + 2 * PADDING)
        direction = state.direction
        # How far the square's low corner lies before the agent, for each direction.
        x_back = jnp.array([0, size // 2, size - 1, size // 2], jnp.int32)[direction]
        y_back = jnp.array([size // 2, 0, size // 2, size - 1], jnp.int32)[direction]
        x, y = state.position
        square = jax.lax.dynamic_slice(
            plane, (x + PADDING - x_back, y + PADDING - y_back), (size, size)
        )
        turned = jnp.where(direction == 2, square.T, square)
        turned = jnp.where(direction == 0, square.T, turned)
        turned = jnp.where((direction == 0) | (direction == 1), turned[:, ::-1], turned)
        return jnp.where((direction == 1) | (direction == 2), turned[::-1], turned)


@dataclass(frozen=True)
class ImageSensor(Sensor):
    """The agent's view in MiniGrid's encoding, uint8[view_size, view_size, 3].

    Indexed [vx, vy, channel]; the channels are type, colour and door state. See
    `PackedImageSensor`.
    """

    width: int
    height: int
    view_size: int = VIEW_SIZE
    see_through_walls: bool = False

    def __post_init__(self) -> None:
        self._packed  # noqa: B018 (it checks the view size)

    @property
    def _packed(self) -> PackedImageSensor:
        return PackedImageSensor(self.width, self.height, self.view_size, self.see_through_walls)

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the image."""
        return Box(0, 255, (self.view_size, self.view_size, 3), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the image."""
        return tiles.decode(self._packed.observe(state, task_state))


@dataclass(frozen=True)
class DirectionSensor(Sensor):
    """The agent's direction, int32: 0 right, 1 down, 2 left, 3 up."""

    @property
    def space(self) -> Discrete:
        """Four directions."""
        return Discrete(4)

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the direction."""
        del task_state
        return state.direction


@dataclass(frozen=True)
class MissionSensor(Sensor):
    """The mission, int32[MISSION_LENGTH] tokens; `decode_mission` turns them into text."""

    @property
    def space(self) -> Box:
        """Tokens of the vocabulary."""
        return Box(0, missions.VOCABULARY_SIZE - 1, (missions.MISSION_LENGTH,), "int32")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the tokens."""
        del state
        return task_state.mission


def _visible(view: jax.Array) -> jax.Array:
    """Returns bool[size, size]: which cells of `view` the agent sees.

    Light starts in the agent's cell and goes row by row away from it. In a row it spreads sideways
    through see-through cells; every cell it leaves, and both neighbours, are seen in that row and
    lit in the next. Rows are bit masks (bit vx), and a scan walks them: written out as elementwise
    code, XLA's CPU backend would compute the first rows again for every cell of the last.
    """
    size = view.shape[0]
    bits = (1 << jnp.arange(size, dtype=jnp.int32))[:, None]
    clear = jnp.sum(jnp.where(is_kind(view, _OPAQUE), 0, bits), axis=0, dtype=jnp.int32)

    def row(lit: jax.Array, clear: jax.Array) -> tuple[jax.Array, jax.Array]:
        spread = _flood(lit & clear, clear, size)
        reached = (spread | spread << 1 | spread >> 1) & ((1 << size) - 1)
        return reached, lit | reached

    _, seen = jax.lax.scan(row, jnp.int32(1 << size // 2), clear, reverse=True)
    return (seen[None, :] & bits) != 0


def _flood(seeds: jax.Array, clear: jax.Array, size: int) -> jax.Array:
    """Returns the bits of `clear` joined to one of `seeds` by a run of set bits (by doubling)."""
    left = right = seeds
    left_run = right_run = clear
    distance = 1
    while distance < size:
        left |= left_run & (left << distance)
        right |= right_run & (right >> distance)
        left_run &= left_run << distance
        right_run &= right_run >> distance
        distance *= 2
    return left | right
