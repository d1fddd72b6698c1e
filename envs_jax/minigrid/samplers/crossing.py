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
        chosen = jnp.argsort(jnp.argsort(order)) < count
        vertical, horizontal = chosen[:lines], chosen[lines:]
        # A random arrangement of as many steps over vertical rivers as there are such rivers.
        eastward = jnp.argsort(jnp.argsort(path)) < jnp.sum(vertical, dtype=jnp.int32)

        board = self._rivers(vertical, horizontal)
        for cell in self._openings(vertical, horizontal, eastward, gaps):
            board = placement.put(board, cell, tiles.EMPTY_TILE)
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
    ) -> list[jax.Array]:
        """Returns the cells, int32[2] each, where the path crosses the rivers."""

        def limits(chosen: jax.Array) -> jax.Array:
            places = 2 + 2 * jnp.arange(chosen.shape[0], dtype=jnp.int32)
            bank = jnp.sort(jnp.where(chosen, places, jnp.int32(self.size - 1)))
            edge = jnp.full(1, self.size - 1, jnp.int32)
            return jnp.concatenate([jnp.zeros(1, jnp.int32), bank, edge])

        xs, ys = limits(vertical), limits(horizontal)
        column = row = jnp.int32(0)
        cells = []
        for step in range(self.num_crossings):
            east = eastward[step]
            along_x = placement.uniform_int(draws[step], xs[column] + 1, xs[column + 1])
            along_y = placement.uniform_int(draws[step], ys[row] + 1, ys[row + 1])
            x = jnp.where(east, xs[column + 1], along_x)
            y = jnp.where(east, along_y, ys[row + 1])
            cells.append(jnp.stack([x, y]))
            column = column + east.astype(jnp.int32)
            row = row + (~east).astype(jnp.int32)
        return cells
