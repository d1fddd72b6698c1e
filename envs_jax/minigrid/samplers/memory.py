"""MiniGrid-Memory: an object in a room, a hallway, and at its end the same object to be found."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import rules, tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "go to the matching object at the end of the hallway"

_MIN_END = 4


@dataclass(frozen=True)
class MemorySampler(TaskSampler):
    """A square of odd `size`; the hallway is as long as it can be, or of `random_length`.

    The objects are a green key and a green ball. The agent starts on its way along the hallway.

    Source: `MemoryEnv` of minigrid 3.2.0.
    """

    size: int
    max_steps: int
    random_length: bool = False

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        draws = jax.random.uniform(key, (4,), jnp.float32)
        middle = self.size // 2
        end = jnp.int32(self.size - 3)
        if self.random_length:
            end = placement.uniform_int(draws[0], _MIN_END, self.size - 2)
        board = self._hallway(end)
        start = jnp.stack([placement.uniform_int(draws[1], 1, end + 1), jnp.int32(middle)])

        cue_is_key, upper_is_key = draws[2] < 0.5, draws[3] < 0.5
        upper, lower = (jnp.stack([end + 1, jnp.int32(middle + dy)]) for dy in (-2, 2))
        cue = jnp.array([1, middle - 1], jnp.int32)
        board = placement.put(board, cue, _look(cue_is_key))
        board = placement.put(board, upper, _look(upper_is_key))
        board = placement.put(board, lower, _look(~upper_is_key))
        inward = jnp.array([0, 1], jnp.int32)
        is_upper = cue_is_key == upper_is_key
        match = jnp.where(is_upper, upper + inward, lower - inward)
        other = jnp.where(is_upper, lower - inward, upper + inward)
        state = placement.grid_state(board, start, jnp.int32(0))
        return placement.rule_episode(
            state,
            rules.MATCH,
            encode_mission(MISSION),
            self.max_steps,
            cells=[match, other],
        )

    def _hallway(self, end: jax.Array) -> jax.Array:
        """Returns the plane without objects; column `end` is the hallway's end wall."""
        middle = self.size // 2
        plane = placement.walled(self.size, self.size)
        plane[1:5, [middle - 2, middle + 2]] = tiles.WALL_TILE
        plane[4, [middle - 1, middle + 1]] = tiles.WALL_TILE
        x, y = jnp.indices(plane.shape, jnp.int32)
        beside = (x > 4) & (x < end) & (jnp.abs(y - middle) == 1)
        across = (x == end) & (y != middle) | (x == end + 2)
        return jnp.where(beside | across, jnp.uint8(tiles.WALL_TILE), jnp.asarray(plane))


def _look(is_key: jax.Array) -> jax.Array:
    key, ball = (jnp.uint8(tiles.tile(kind, tiles.GREEN)) for kind in (tiles.KEY, tiles.BALL))
    return jnp.where(is_key, key, ball)
