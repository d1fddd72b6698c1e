"""What the agent senses: its partial view, its heading and its mission.

The view is computed on packed tiles, one byte a cell, and decoded at the very end. View cell
(vx, vy) counts vx from left to right and vy from far (0) to the agent's own row; the agent stands
in the middle of that row, looking towards vy = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, sight, tiles
from envs_jax.minigrid.environment import heading
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.errors import JaxactError
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Box, Discrete

VIEW_SIZE = 7
# A row of the view is held in the bits of an int32.
MAX_VIEW_SIZE = 31

_OPAQUE = 1 << tiles.WALL | 1 << tiles.CLOSED_DOOR | 1 << tiles.LOCKED_DOOR


@dataclass(frozen=True)
class GridSensor(Sensor):
    """What image sensors share: the grid, the agent's view of it, and pictures for people.

    Attributes:
      width: cells of the grid along x.
      height: cells of the grid along y.
      view_size: edge of the agent's view in cells, odd, from 3 to 31.
      see_through_walls: whether walls and shut doors hide nothing.
    """

    width: int
    height: int
    view_size: int = VIEW_SIZE
    see_through_walls: bool = False

    def __post_init__(self) -> None:
        if self.view_size not in range(3, MAX_VIEW_SIZE + 1, 2):
            raise JaxactError(
                f"view_size must be odd, from 3 to {MAX_VIEW_SIZE}; got {self.view_size!r}"
            )

    @property
    def view(self) -> PackedImageSensor:
        """The sensor of the agent's own view, packed."""
        return PackedImageSensor(self.width, self.height, self.view_size, self.see_through_walls)

    def picture(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the world from above, what is seen lighter, beside the agent's own view."""
        # The renderer lightens what the sensor sees, so it imports this module.
        from envs_jax.minigrid.rendering import render, render_egocentric

        tile_size = 32 if max(self.width, self.height) <= 10 else 16
        world = render(
            state,
            self.width,
            self.height,
            tile_size,
            view_size=self.view_size,
            see_through_walls=self.see_through_walls,
        )
        view = render_egocentric(self.view.observe(state, task_state), tile_size)
        tall = max(world.shape[0], view.shape[0])

        def padded(frame: jax.Array, right: int) -> jax.Array:
            return jnp.pad(frame, ((0, tall - frame.shape[0]), (0, right), (0, 0)))

        return jnp.concatenate([padded(world, tile_size // 2), padded(view, 0)], axis=1)


@dataclass(frozen=True)
class PackedImageSensor(GridSensor):
    """The agent's view as packed tiles, uint8[view_size, view_size], indexed [vx, vy].

    `tiles.decode` turns it into MiniGrid's image. What is carried shows in the agent's own cell;
    cells out of sight are 0.

    Source: `MiniGridEnv.gen_obs_grid` and `Grid.process_vis` of minigrid 3.2.0.
    """

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the view."""
        return Box(0, 255, (self.view_size, self.view_size), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the view."""
        del task_state
        size = self.view_size
        around = max(PADDING, size - 1)
        plane = jnp.pad(state.tiles, around - PADDING, constant_values=tiles.WALL_TILE)
        ahead = sight.rows_ahead(plane, state.position + around, state.direction, size)
        hand = jnp.where(state.carrying == 0, jnp.uint8(tiles.EMPTY_TILE), state.carrying)
        if self.see_through_walls:
            return ahead.at[size - 1, size // 2].set(hand).T
        return sight.in_sight(ahead, hand, _OPAQUE).T

    def visible(self, state: GridState) -> jax.Array:
        """Returns which cells of the grid are in sight, bool[W, H], indexed [x, y]."""
        around = self.view_size - 1
        plane = state.tiles[PADDING:-PADDING, PADDING:-PADDING]
        lit = self.observe(state, None) != tiles.UNSEEN
        framed = jnp.pad(jnp.zeros(plane.shape, bool), around)
        framed = framed.at[_looked_at(state, self.view_size)].set(lit)
        return framed[around:-around, around:-around]


@dataclass(frozen=True)
class ImageSensor(GridSensor):
    """The agent's view in MiniGrid's encoding, uint8[view_size, view_size, 3].

    Indexed [vx, vy, channel]; the channels are type, colour and door state. See
    `PackedImageSensor`.
    """

    @property
    def space(self) -> Box:
        """Shape, dtype and bounds of the image."""
        return Box(0, 255, (self.view_size, self.view_size, 3), "uint8")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the image."""
        return tiles.decode(self.view.observe(state, task_state))


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
    """The mission, int32[length] tokens; `decode_mission` turns them into text."""

    length: int = missions.MISSION_LENGTH

    @property
    def space(self) -> Box:
        """Tokens of the vocabulary."""
        return Box(0, missions.VOCABULARY_SIZE - 1, (self.length,), "int32")

    def observe(self, state: GridState, task_state: PyTree) -> jax.Array:
        """Returns the tokens."""
        del state
        return task_state.mission

    def text(self, reading: jax.Array) -> str:
        """Puts a reading into words: the mission as MiniGrid writes it."""
        return missions.decode_mission(reading)


def _looked_at(state: GridState, view_size: int) -> tuple[jax.Array, jax.Array]:
    """Returns the coordinates, int32[V, V] each, of the view's cells [vx, vy].

    They count from V − 1 cells beyond the grid's corner, so that none is negative.
    """
    forward = heading(state.direction)
    right = jnp.stack([-forward[1], forward[0]])
    steps = jnp.arange(view_size, dtype=jnp.int32)
    aside, ahead = (steps - view_size // 2)[:, None], (view_size - 1 - steps)[None, :]
    x, y = (
        state.position[axis] + view_size - 1 + ahead * forward[axis] + aside * right[axis]
        for axis in range(2)
    )
    return x, y
