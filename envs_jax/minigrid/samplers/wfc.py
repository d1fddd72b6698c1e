"""MiniGrid-WFC: mazes, rooms and obstacles to be traversed, in six looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import encode_mission
from envs_jax.minigrid.samplers import placement
from jaxact.pomdp import Episode, PyTree, TaskSampler

MISSION = "traverse the maze to get to the goal"
SIZE = 25

Look = Literal[
    "MazeSimple",
    "DungeonMazeScaled",
    "RoomsFabric",
    "ObstaclesBlackdots",
    "ObstaclesAngular",
    "ObstaclesHogs3",
]

# Cells along a side within the walls round the grid.
_INSIDE = SIZE - 2
# Edge of the blocks that some looks are put together from, and blocks along a side: they cover one
# cell too many.
_BLOCK = 4
_BLOCKS = -(-_INSIDE // _BLOCK)
# Share of walls in the noise that grows into ObstaclesHogs3, and rounds of growth.
_NOISE, _ROUNDS = 0.46, 2


@dataclass(frozen=True)
class WFCSampler(TaskSampler):
    """A pattern of walls, of which the largest connected part is kept open.

    What follows the pattern is done as in the package: open cells that are not 4-connected to the
    largest part become wall, there is a wall round the grid, and start and goal are a uniform pair
    of different open cells.

    The pattern itself is not the package's. There it is made by wave function collapse, from
    pictures that are no part of the package's distribution, with retries without a limit on work.
    Here each look has a small generator of fixed work that answers the package's description:

    - `MazeSimple`: corridors one cell wide, with dead ends and a few loops; all connected.
    - `DungeonMazeScaled`: the same at a larger scale, corridors two cells wide.
    - `RoomsFabric`: a weave of small rooms, some with a pillar, whose walls are whole, have a
      doorway in the middle, or are left out.
    - `ObstaclesBlackdots`: dots of wall, small and large, in the open.
    - `ObstaclesAngular`: diagonal strokes, chevrons and corners.
    - `ObstaclesHogs3`: dense, rounded obstacles, grown from noise.

    Source: `WFCEnv` of minigrid 3.2.0, apart from the pattern.
    """

    look: Look
    max_steps: int

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        pattern = _PATTERNS[self.look]
        draws = jax.random.uniform(key, (3 + pattern.num_draws,), jnp.float32)
        walls = jnp.pad(pattern.walls(draws[3:]), 1, constant_values=True)
        free = placement.largest_component(~walls)
        board = jnp.where(free, jnp.uint8(tiles.EMPTY_TILE), jnp.uint8(tiles.WALL_TILE))
        position, _ = placement.choose_cell(draws[0], free)
        goal, _ = placement.choose_cell(draws[1], free & ~placement.at(position, free.shape))
        board = placement.put(board, goal, tiles.GOAL_TILE)
        state = placement.grid_state(board, position, placement.uniform_int(draws[2], 0, 4))
        return placement.goal_episode(state, encode_mission(MISSION), self.max_steps)


class _Pattern(NamedTuple):
    """How a look is made: `walls` turns uniform draws float32[num_draws] into bool[23, 23]."""

    num_draws: int
    walls: Callable[[jax.Array], jax.Array]


def _maze(corridor: int) -> _Pattern:
    """Returns the mazes of corridors `corridor` cells wide, with walls one cell thick.

    From each pillar between four rooms of the maze one wall goes to a neighbouring pillar, never
    to that above, but in the first row. So no walls close a ring, and all rooms stay connected;
    where two pillars choose the same wall, there is a way round them. The maze is then turned, as
    the rule favours one direction.
    """
    rooms = (_INSIDE + 1) // (corridor + 1)
    pillars = rooms - 1
    # Rooms and pillars alternate; each is given its width.
    places = np.repeat(np.arange(2 * rooms - 1), [corridor, 1] * pillars + [corridor])

    def walls(draws: jax.Array) -> jax.Array:
        kinds = np.full((pillars, pillars), 3, np.int32)
        kinds[:, 0] = 4
        ways = placement.uniform_int(draws[1:].reshape(kinds.shape), 0, jnp.asarray(kinds))
        plan = jnp.zeros((2 * rooms - 1, 2 * rooms - 1), bool).at[1::2, 1::2].set(True)
        plan = plan.at[2::2, 1::2].max(ways == 0).at[0:-1:2, 1::2].max(ways == 1)
        plan = plan.at[1::2, 2::2].max(ways == 2).at[1::2, 0:-1:2].max(ways == 3)
        turned = [jnp.rot90(plan, quarters) for quarters in range(4)]
        plan = jax.lax.select_n(placement.uniform_int(draws[0], 0, 4), *turned)
        return plan[places[:, None], places[None, :]]

    return _Pattern(1 + pillars**2, walls)


def _patchwork(blocks: np.ndarray) -> _Pattern:
    """Returns the patterns made of blocks drawn from `blocks`, bool[n, 4, 4], side by side."""

    def walls(draws: jax.Array) -> jax.Array:
        chosen = placement.uniform_int(draws, 0, len(blocks)).reshape(_BLOCKS, _BLOCKS)
        plane = jnp.asarray(blocks)[chosen].swapaxes(1, 2)
        return plane.reshape(_BLOCKS * _BLOCK, _BLOCKS * _BLOCK)[:_INSIDE, :_INSIDE]

    return _Pattern(_BLOCKS**2, walls)


def _rooms() -> np.ndarray:
    """Returns rooms of three cells a side, with a wall beyond x = 2 and one beyond y = 2."""
    whole, doorway, none = (1, 1, 1), (1, 0, 1), (0, 0, 0)
    kinds = (whole, doorway, doorway, none)
    blocks = np.zeros((2 * len(kinds) ** 2, _BLOCK, _BLOCK), bool)
    for block, (right, below, pillar) in zip(
        blocks, product(kinds, kinds, (False, True)), strict=True
    ):
        block[3, :3], block[:3, 3] = right, below
        block[3, 3], block[1, 1] = True, pillar
    return blocks


def _dots() -> np.ndarray:
    """Returns blocks with a dot of one or two cells a side somewhere, or with none."""
    blocks = [np.zeros((_BLOCK, _BLOCK), bool)]
    for size, x, y in product((1, 2), range(3), range(3)):
        block = np.zeros((_BLOCK, _BLOCK), bool)
        block[x : x + size, y : y + size] = True
        blocks.append(block)
    return np.stack(blocks)


def _angles() -> np.ndarray:
    """Returns strokes, chevrons and corners, turned in all ways, and empty blocks."""
    # Strokes of neighbouring blocks do not meet: they would cut much of the grid off.
    stroke = np.diag([True, True, True, False])
    chevron = np.array([[1, 0, 0, 1], [0, 1, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], bool)
    corner = np.array([[1, 1, 1, 0], [1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], bool)
    shapes = [np.rot90(shape, turn) for shape in (stroke, chevron, corner) for turn in range(4)]
    return np.stack([*shapes, *[np.zeros((_BLOCK, _BLOCK), bool)] * 4])


def _grown(draws: jax.Array) -> jax.Array:
    """Returns obstacles grown from noise: what most cells around are, a cell becomes.

    The cell in the middle and those around it stay open, so that there always is a place to be.
    """
    steps = np.abs(np.arange(_INSIDE) - _INSIDE // 2) <= 1
    clearing = steps[:, None] & steps[None, :]
    walls = draws.reshape(_INSIDE, _INSIDE) < _NOISE
    for _ in range(_ROUNDS):
        counts = jnp.pad(walls.astype(jnp.int32), 1)
        counts = counts[:-2] + counts[1:-1] + counts[2:]
        walls = counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:] >= 5
    return walls & ~clearing


_PATTERNS: dict[Look, _Pattern] = {
    "MazeSimple": _maze(1),
    "DungeonMazeScaled": _maze(2),
    "RoomsFabric": _patchwork(_rooms()),
    "ObstaclesBlackdots": _patchwork(_dots()),
    "ObstaclesAngular": _patchwork(_angles()),
    "ObstaclesHogs3": _Pattern(_INSIDE**2, _grown),
}
LOOKS: tuple[Look, ...] = tuple(_PATTERNS)
