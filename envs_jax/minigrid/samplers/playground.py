"""MiniGrid-Playground: nine rooms, a dozen things, nothing to achieve."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import rules, tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import packed, random_object
from jaxact.pomdp import Episode, PyTree, TaskSampler

_OBJECTS = 12


@dataclass(frozen=True)
class PlaygroundSampler(TaskSampler):
    """A square of 19 cells a side: three by three rooms with a door in every wall between two.

    Source: `PlaygroundEnv` of minigrid 3.2.0.
    """

    max_steps: int
    size: int = 19

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (2 * _OBJECTS + 14,), jnp.float32)
        looks, objects, rest = jnp.split(draws, [_OBJECTS, 2 * _OBJECTS])
        pitch = self.size // 3
        plane = placement.walled(self.size, self.size)
        plane[::pitch, :] = tiles.WALL_TILE
        plane[:, ::pitch] = tiles.WALL_TILE
        board = self._with_doors(jnp.asarray(plane), rest[2:], pitch)
        position, _ = placement.choose_cell(rest[0], board == tiles.EMPTY_TILE)
        direction = placement.uniform_int(rest[1], 0, 4)
        elsewhere = ~placement.at(position, board.shape)

        def place(board: jax.Array, pair: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            code, _ = random_object(pair[0])
            cell, _ = placement.choose_cell(pair[1], elsewhere & (board == tiles.EMPTY_TILE))
            return placement.put(board, cell, code), None

        board, _ = jax.lax.scan(place, board, (looks, objects))
        state = placement.grid_state(board, position, direction)
        return placement.rule_episode(state, rules.PLAY, encode_mission(""), self.max_steps)

    def _with_doors(self, board: jax.Array, draws: jax.Array, pitch: int) -> jax.Array:
        """Puts a shut door of random colour into each wall; one draw a door."""
        colors, rest = placement.split_draw(draws, tiles.NUM_COLORS)
        # A door keeps a distance from the wall to come, but not from the one before.
        along = placement.uniform_int(rest, 1, pitch - 1)
        doors = packed(tiles.CLOSED_DOOR, colors)
        number = 0
        for wall in (pitch, 2 * pitch):
            for room in range(0, 3 * pitch, pitch):
                across = room + along[number]
                board = board.at[wall, across].set(doors[number])
                across = room + along[number + 1]
                board = board.at[across, wall].set(doors[number + 1])
                number += 2
        return board
