"""MiniGrid-Fetch, -GoToObject and -PutNear: a room, some objects, and something to do with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, rules, tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.room_grid import packed
from envs_jax.minigrid.state import GridState
from jaxact.pomdp import Episode, PyTree, TaskSampler

Errand = Literal["fetch", "go to", "put near"]

_FETCH_MISSIONS = (
    "get a {0} {1}",
    "go get a {0} {1}",
    "fetch a {0} {1}",
    "go fetch a {0} {1}",
    "you must fetch a {0} {1}",
)
_GO_TO_MISSION = "go to the {0} {1}"
_PUT_NEAR_MISSION = "put the {0} {1} near the {2} {3}"


@dataclass(frozen=True)
class ObjectsSampler(TaskSampler):
    """A room of `size` × `size` cells with `num_objects` objects; `errand` says what to do.

    - "fetch": take one of the objects, which are keys and balls and may look alike;
    - "go to": go next to one of the objects, no two of which look alike;
    - "put near": put one of the objects near another; no two look alike, none are neighbours.

    Source: `FetchEnv`, `GoToObjectEnv` and `PutNearEnv` of minigrid 3.2.0.
    """

    size: int
    num_objects: int
    max_steps: int
    errand: Errand

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        count = self.num_objects
        draws = jax.random.uniform(key, (2 * count + 4,), jnp.float32)
        codes = self._looks(draws[:count])
        board, cells = self._scatter(codes, draws[count : 2 * count])
        agent, heading, choice, other_choice = draws[2 * count :]
        position, _ = placement.choose_cell(agent, board == tiles.EMPTY_TILE)
        state = placement.grid_state(board, position, placement.uniform_int(heading, 0, 4))
        chosen = placement.uniform_int(choice, 0, count)
        target, cell = codes[chosen], cells[chosen]
        if self.errand == "fetch":
            mission = self._fetch_mission(target, other_choice)
            return placement.rule_episode(
                state, rules.FETCH, mission, self.max_steps, target=target
            )
        if self.errand == "go to":
            mission = missions.fill(_GO_TO_MISSION, *_words(target))
            return placement.rule_episode(
                state, rules.GO_NEXT_TO, mission, self.max_steps, cells=[cell]
            )
        return self._put_near(state, codes, cells, chosen, other_choice)

    def _put_near(
        self,
        state: GridState,
        codes: jax.Array,
        cells: jax.Array,
        moved: jax.Array,
        draw: jax.Array,
    ) -> Episode:
        other = (moved + placement.uniform_int(draw, 1, self.num_objects)) % self.num_objects
        words = *_words(codes[moved]), *_words(codes[other])
        return placement.rule_episode(
            state,
            rules.PUT_NEAR,
            missions.fill(_PUT_NEAR_MISSION, *words),
            self.max_steps,
            target=codes[moved],
            cells=[cells[other]],
        )

    def _looks(self, draws: jax.Array) -> jax.Array:
        """Returns the objects' packed tiles, uint8[num_objects]."""
        if self.errand == "fetch":
            looks, _ = placement.split_draw(draws, 2 * tiles.NUM_COLORS)
            kinds = jnp.where(looks % 2 == 0, tiles.KEY, tiles.BALL)
            return packed(kinds, looks // 2)
        unused = jnp.ones((3, tiles.NUM_COLORS), bool)
        codes = []
        for draw in draws:
            look, _ = placement.choose_cell(draw, unused)
            unused = unused & ~placement.at(look, unused.shape)
            codes.append(packed(tiles.KEY + look[0], look[1]))
        return jnp.stack(codes)

    def _scatter(self, codes: jax.Array, draws: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Returns the room with the objects in it, and their cells int32[num_objects, 2]."""
        board = jnp.asarray(placement.walled(self.size, self.size))
        x, y = jnp.indices(board.shape, jnp.int32)
        free = board == tiles.EMPTY_TILE
        cells = []
        for code, draw in zip(codes, draws, strict=True):
            cell, _ = placement.choose_cell(draw, free)
            board = placement.put(board, cell, code)
            distance = jnp.maximum(jnp.abs(x - cell[0]), jnp.abs(y - cell[1]))
            free = free & (distance > (1 if self.errand == "put near" else 0))
            cells.append(cell)
        return board, jnp.stack(cells)

    def _fetch_mission(self, target: jax.Array, draw: jax.Array) -> jax.Array:
        wordings = [missions.fill(wording, *_words(target)) for wording in _FETCH_MISSIONS]
        return jnp.stack(wordings)[placement.uniform_int(draw, 0, len(wordings))]


def _words(code: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the tokens of the words for an object's colour and kind."""
    color, kind = code >> tiles.COLOR_SHIFT, code & tiles.TYPE_MASK
    return jnp.asarray(missions.COLOR_TOKENS)[color], jnp.asarray(missions.KIND_TOKENS)[kind]
