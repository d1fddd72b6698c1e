"""MiniGrid-LavaCrossing and -SimpleCrossing: rivers of lava, or walls, each with one crossing."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

LAVA_MISSION = "avoid the lava and get to the green goal square"
WALL_MISSION = "find the opening and get to the green goal square"


@dataclass(frozen=True)
class CrossingSampler(TaskSampler):
    """A square of odd `size` crossed by `num_crossings` rivers on even rows and columns.

    The rivers are of lava, or of wall with `walls`. A monotone path over the blocks of land between
    them, from the agent's corner to the goal's, says which stretch of each river has its opening.

    Source: `CrossingEnv` of minigrid 3.2.0.
    """

    size: int
    num_crossings: int
    max_steps: int
    walls: bool = False

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        count = self.num_crossings
        lines = (self.size - 3) // 2  # Rivers that can run in one direction.
        draws = jax.random.uniform(key, (2 * lines + 2 * count,), jnp.float32)
        order, path, gaps = jnp.split(draws, [2 * lines, 2 * lines + count])
        # The first `count` of a random order of all rivers.
        chosen = placement.ranks(order) < count
        vertical, horizontal = chosen[:lines], chosen[lines:]
        # A random arrangement of as many steps over vertical rivers as there are such rivers.
        eastward = placement.ranks(path) < jnp.sum(vertical, dtype=jnp.int32)

        x, y = self._openings(vertical, horizontal, eastward, gaps)
        cells = jnp.arange(self.size, dtype=jnp.int32)
        is_opening = jnp.any((x[:, None, None] == cells[:, None]) & (y[:, None, None] == cells), 0)
        board = self._rivers(vertical, horizontal)
        board = jnp.where(is_opening, jnp.uint8(tiles.EMPTY_TILE), board)
        state = placement.grid_state(board, jnp.ones(2, jnp.int32), jnp.int32(0))
        mission = encode_mission(WALL_MISSION if self.walls else LAVA_MISSION)
        return placement.goal_episode(state, mission, self.max_steps)

    def _rivers(self, vertical: jax.Array, horizontal: jax.Array) -> jax.Array:
        """Returns the plane with its rivers, whole."""
        plane = placement.walled(self.size, self.size)
        plane[-2, -2] = tiles.GOAL_TILE
        land = plane == tiles.EMPTY_TILE

        def spread(chosen: jax.Array) -> jax.Array:
            return jnp.zeros(self.size, bool).at[2 : self.size - 2 : 2].set(chosen)

        wet = spread(vertical)[:, None] | spread(horizontal)[None, :]
        river = tiles.WALL_TILE if self.walls else tiles.LAVA_TILE
        return jnp.where(wet & jnp.asarray(land), jnp.uint8(river), jnp.asarray(plane))

    def _openings(
        self, vertical: jax.Array, horizontal: jax.Array, eastward: jax.Array, draws: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Returns where the path crosses the rivers, one after the other: x and y, int32[count]."""

        def banks(chosen: jax.Array, crossed: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Returns the rivers, or outer walls, on both sides once so many are crossed."""
            number = placement.running_sums(chosen.astype(jnp.int32))
            river = 2 + 2 * jnp.arange(chosen.shape[0], dtype=jnp.int32)
            before = chosen & (number <= crossed[:, None])
            after = chosen & (number > crossed[:, None])
            return (
                jnp.max(jnp.where(before, river, jnp.int32(0)), axis=1),
                jnp.min(jnp.where(after, river, jnp.int32(self.size - 1)), axis=1),
            )

        steps = jnp.arange(self.num_crossings, dtype=jnp.int32)
        crossed = placement.running_sums(eastward.astype(jnp.int32)) - eastward.astype(jnp.int32)
        west, east = banks(vertical, crossed)
        north, south = banks(horizontal, steps - crossed)
        along_x = placement.uniform_int(draws, west + 1, east)
        along_y = placement.uniform_int(draws, north + 1, south)
        return jnp.where(eastward, east, along_x), jnp.where(eastward, along_y, south)
