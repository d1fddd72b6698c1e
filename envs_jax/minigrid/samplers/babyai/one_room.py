"""BabyAI's GoTo levels of one room: an agent, some objects, and one of them to go to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from envs_jax.minigrid import missions, tiles
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.tasks import InstructionState
from jaxact.pomdp import Episode, PyTree, TaskSampler

Target = Literal["any", "red ball", "red ball among grey", "red or blue ball"]


class _Level(NamedTuple):
    """A room with the agent in it; of objects drawn alike the first is the target as well as any.

    uint8[size, size] tiles, int32[2], int32, and uint8[num_objects] tiles, the target's first.
    """

    board: jax.Array
    position: jax.Array
    direction: jax.Array
    codes: jax.Array


@dataclass(frozen=True)
class GoToSampler(TaskSampler):
    """A room of `size` × `size` cells with `num_objects` objects, `target` among them.

    Objects keep a distance of two from the agent; a level in which one of them is walled in by
    others is drawn again. `target` says what to go to:

    - "any": one of the objects, all of them random;
    - "red ball": one red ball for certain (others may be as red and as round);
    - "red ball among grey": the same, all other objects grey;
    - "red or blue ball": one of these, and no other ball of either colour.

    Source: `GoToObj`, `GoToLocal`, `GoToRedBall`, `GoToRedBallGrey` and `GoToRedBlueBall` of
    minigrid 3.2.0.
    """

    size: int
    num_objects: int
    max_steps: int
    target: Target = "any"

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        # One draw for the agent and one for each object: random bits are the dearest part of this.
        level = placement.until_valid(key, 1 + self.num_objects, self._draw)
        tracked = (level.board == level.codes[0]).astype(jnp.uint16)
        state = placement.grid_state(level.board, level.position, level.direction, tracked)
        horizon = jnp.int32(self.max_steps)
        kind = level.codes[0] & tiles.TYPE_MASK
        color = level.codes[0] >> tiles.COLOR_SHIFT
        several = jnp.sum(level.codes == level.codes[0], dtype=jnp.int32) > 1
        task = InstructionState(
            steps=jnp.int32(0),
            max_steps=horizon,
            mission=missions.go_to(kind, color, several),
            program=None,
            progress=None,
            ghosts=jnp.zeros((1, self.size), jnp.uint32),
        )
        return Episode(state, task, horizon)

    def _draw(self, draws: jax.Array) -> tuple[_Level, jax.Array]:
        """Makes one level of float32[1 + num_objects]; returns it and whether it is valid."""
        direction, agent_draw = placement.split_draw(draws[0], 4)
        looks, cell_draws = placement.split_draw(draws[1:], 3 * tiles.NUM_COLORS)
        kinds, colors = tiles.KEY + looks % 3, looks // 3
        kinds, colors, drawn_well = self._with_target(kinds, colors)
        codes = (kinds | colors << tiles.COLOR_SHIFT).astype(jnp.uint8)

        room = jnp.asarray(placement.walled(self.size, self.size))
        position, _ = placement.choose_cell(agent_draw, room == tiles.EMPTY_TILE)
        board, placed = self._scatter(room, position, codes, cell_draws)
        valid = drawn_well & placed & placement.objects_reachable(board, position)
        return _Level(board, position, direction, codes), valid

    def _with_target(
        self, kinds: jax.Array, colors: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Turns random objects into the level's: their kinds, their colours, whether they may be.

        The first object is the target.
        """
        valid = jnp.bool_(True)
        if self.target == "any":
            return kinds, colors, valid
        color = jnp.int32(tiles.RED)
        if self.target == "red or blue ball":
            # Half of the six colours stand for red, half for blue.
            color = jnp.where(colors[0] % 2 == 0, jnp.int32(tiles.RED), jnp.int32(tiles.BLUE))
            rival = (colors[1:] == tiles.RED) | (colors[1:] == tiles.BLUE)
            valid = ~jnp.any((kinds[1:] == tiles.BALL) & rival)
        if self.target == "red ball among grey":
            colors = jnp.full_like(colors, tiles.GREY)
        return kinds.at[0].set(tiles.BALL), colors.at[0].set(color), valid

    def _scatter(
        self, room: jax.Array, position: jax.Array, codes: jax.Array, draws: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Puts the objects in distinct cells; returns the plane, and false if they did not fit."""
        x, y = jnp.indices(room.shape, jnp.int32)
        far = jnp.abs(x - position[0]) + jnp.abs(y - position[1]) >= 2

        def place(
            board: jax.Array, item: tuple[jax.Array, jax.Array]
        ) -> tuple[jax.Array, jax.Array]:
            code, draw = item
            cell, found = placement.choose_cell(draw, far & (board == tiles.EMPTY_TILE))
            return placement.put(board, cell, code), found

        board, found = jax.lax.scan(place, room, (codes, draws))
        return board, jnp.all(found)
