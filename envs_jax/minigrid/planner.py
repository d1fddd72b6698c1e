"""Shortest plans over poses (x, y, heading): a breadth-first search backward from a set of goals.

The set of poses reached so far is kept as bitboards: for each heading one word a row, whose bit x
is cell (x, y). A turn is then a bitwise or of two headings' boards, and a move is a shift: by one
bit along x, by one word along y. One relaxation of all poses costs a dozen instructions a row.
Words are as narrow as the grid allows, uint8, uint16 or uint32 (below: `word`).

Worlds that can be changed on the way (fetch the key, unlock the door) are layers: a stack of
terrains, where acting on a gate's cell leads from the same pose of one layer to the next. The
search runs through all layers at once, so a plan is the shortest of the whole sequence, not a chain
of shortest pieces.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

# The first three are MiniGrid's own actions; ACT is for the caller to name (toggle, pickup);
# ARRIVED says that the pose is a goal already.
LEFT, RIGHT, FORWARD, ACT, ARRIVED = range(5)

MAX_WIDTH = 32
# Relaxations between two looks at whether the search is over.
_CHUNK = 4

Board = jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Terrain:
    """Where one may walk, in L layers of a grid H rows high; all are bitboards of cells.

    Attributes:
      open: word[L, H], cells entered by a step forward.
      slow: word[L, H], cells to be entered by an act and then a step, such as closed doors;
        disjoint from `open`.
      gates: word[L - 1, H], cells that, faced in layer l and acted upon, lead to layer l + 1;
        disjoint from `open` and `slow` of layer l.
    """

    open: Board
    slow: Board
    gates: Board


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Plan:
    """The beginning and the length of a shortest plan.

    Attributes:
      action: int32 scalar, one of `LEFT`, `RIGHT`, `FORWARD`, `ACT`, `ARRIVED`; meaningless unless
        `reached`.
      distance: int32 scalar, actions to the nearest goal pose; meaningless unless `reached`.
      reached: bool scalar, whether any goal can be reached.
    """

    action: jax.Array
    distance: jax.Array
    reached: jax.Array


def pack(cells: jax.Array) -> Board:
    """Turns cells bool[W, H], W at most 32, into a bitboard word[H].

    Raises:
      ValueError: the grid is too wide for a word.
    """
    width = cells.shape[0]
    if width > MAX_WIDTH:
        raise ValueError(f"a grid {width} cells wide does not fit rows of {MAX_WIDTH} bits")
    word = jnp.uint8 if width <= 8 else jnp.uint16 if width <= 16 else jnp.uint32
    bits = word(1) << jnp.arange(width, dtype=word)[:, None]
    return jnp.sum(jnp.where(cells, bits, word(0)), axis=0, dtype=word)


def contains(board: Board, position: jax.Array) -> jax.Array:
    """Says whether cell `position`, int32[2], is on the board word[H]; bool scalar."""
    return (board[position[1]] >> position[0].astype(board.dtype)) & 1 != 0


def facing(cells: Board) -> Board:
    """Returns word[4, H], for each heading the cells from which one of `cells` is in front."""
    return jnp.stack(_behind((cells,) * 4))


def standing(cells: Board) -> Board:
    """Returns word[4, H], the poses on one of `cells`, in any heading."""
    return jnp.stack((cells,) * 4)


def plan(
    terrain: Terrain,
    goals: Board,
    position: jax.Array,
    direction: jax.Array,
    layer: jax.Array | int = 0,
    active: jax.Array | bool = True,
) -> Plan:
    """Finds a shortest plan from a pose to any goal pose.

    Turning left, turning right, stepping forward and acting cost one action each. Among equally
    short plans those that begin with a turn come first. Under `jax.vmap` all lanes search together,
    until the last one has arrived or is known not to.

    Args:
      terrain: where one may walk.
      goals: word[4, H], goal poses of every layer, as of `facing` or `standing`.
      position: int32[2], (x, y).
      direction: int32 scalar, 0 right, 1 down, 2 left, 3 up.
      layer: int32 scalar, the layer one is in.
      active: bool scalar; a lane that is not is not waited for, and its plan is not reached.

    Returns:
      The plan's first action and length.
    """
    layer = jnp.asarray(layer, jnp.int32)
    lane = (terrain, goals, position, direction, layer, jnp.asarray(active))
    batch: Any = jax.tree.map(lambda leaf: leaf[None], lane)
    headings, reached = jax.tree.map(lambda leaf: leaf[0], _search(*batch))
    distance = headings[direction]
    left, right = headings[(direction + 3) % 4], headings[(direction + 1) % 4]
    ahead = position + jnp.array([[1, 0], [0, 1], [-1, 0], [0, -1]], jnp.int32)[direction]
    straight = jnp.where(contains(terrain.open[layer], ahead), FORWARD, ACT)
    action = jnp.select(
        [distance == 0, left < distance, right < distance], [ARRIVED, LEFT, RIGHT], straight
    )
    return Plan(action.astype(jnp.int32), distance, reached)


class _World(NamedTuple):
    """The terrains and poses of N lanes.

    Lanes are the last axis: so the inner loops run along them, whatever the size of the grid.

    Attributes:
      open: L boards word[H, N].
      slow: L boards, or None where no lane has a slow cell.
      gates: L - 1 times four boards, one a heading: poses that face a gate.
      goals: four boards.
      row, column, direction, layer: int32[N], the lanes' own poses.
      active: bool[N].
    """

    open: tuple[Board, ...]
    slow: tuple[Board, ...] | None
    gates: tuple[tuple[Board, ...], ...]
    goals: tuple[Board, ...]
    row: jax.Array
    column: jax.Array
    direction: jax.Array
    layer: jax.Array
    active: jax.Array


# Poses reached, as boards[layer][heading].
_Boards = tuple[tuple[Board, ...], ...]


@custom_vmap
def _search(
    terrain: Terrain,
    goals: Board,
    position: jax.Array,
    direction: jax.Array,
    layer: jax.Array,
    active: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Searches for N lanes at once; every argument has a leading axis N.

    Returns:
      int32[N, 4], distances of the four headings at each lane's cell and layer, exact up to that of
      its own heading and no less than that beyond; and bool[N], whether its pose was reached.
    """
    opens, slows, gates, seeds = (
        jnp.moveaxis(boards, 0, -1) for boards in (terrain.open, terrain.slow, terrain.gates, goals)
    )

    layered = _World(
        open=tuple(opens),
        slow=tuple(slows),
        gates=tuple(_behind((board,) * 4) for board in gates),
        goals=tuple(seeds),
        row=position[:, 1],
        column=position[:, 0],
        direction=direction,
        layer=layer,
        active=active,
    )
    own = opens[layer, :, jnp.arange(len(layer))].T
    plain = layered._replace(open=(own,), slow=None, gates=(), layer=jnp.zeros_like(layer))
    # Few worlds have doors; a look at all lanes at once spares the others layers and slow cells.
    has_slow, has_gates = jnp.any(terrain.slow != 0), jnp.any(terrain.gates != 0)
    if layered.gates:
        variants = [plain, layered._replace(slow=None), layered]
        variant = jnp.select([~jnp.any(active), has_slow, has_gates], [0, 2, 1], 0)
    else:
        variants, variant = [plain, layered], (jnp.any(active) & has_slow).astype(jnp.int32)
    return lax.switch(variant, [functools.partial(_flood, world) for world in variants])


@_search.def_vmap
def _search_batch(axis_size: int, in_batched: Any, *arguments: Any) -> Any:
    """Folds one more axis of lanes into the one there is."""
    batched = jax.tree.map(
        lambda leaf, is_batched: (
            leaf if is_batched else jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
        ),
        arguments,
        tuple(in_batched),
    )
    lanes = batched[-1].shape[1]
    flat = jax.tree.map(lambda leaf: leaf.reshape(axis_size * lanes, *leaf.shape[2:]), batched)
    result = jax.tree.map(
        lambda leaf: leaf.reshape(axis_size, lanes, *leaf.shape[1:]), _search(*flat)
    )
    return result, (True, True)


def _flood(world: _World) -> tuple[jax.Array, jax.Array]:
    """Grows the reached poses from the goals until every lane has arrived or nothing grows."""
    passable = world.open
    if world.slow is not None:
        passable = tuple(a | b for a, b in zip(world.open, world.slow, strict=True))
    seeds = tuple(tuple(goal & cells for goal in world.goals) for cells in passable)

    def once(_: int, carry: Any) -> Any:
        boards, before, headings = carry
        grown = _relax(world, passable, boards, before)
        # Without slow cells the boards of one action ago are never read.
        before = before if world.slow is None else boards
        return grown, before, headings + _missing(world, boards)

    def chunk(carry: Any) -> Any:
        start, before, headings, _ = carry
        boards, before, headings = lax.fori_loop(0, _CHUNK, once, (start, before, headings))
        pairs = zip(jax.tree.leaves(start), jax.tree.leaves(boards), strict=True)
        changed = functools.reduce(jnp.bitwise_or, (old ^ new for old, new in pairs))
        growing = jnp.any(changed != 0, axis=0)
        return boards, before, headings, _waiting(world, boards) & growing

    before: Any = () if world.slow is None else jax.tree.map(jnp.zeros_like, seeds)
    headings = jnp.zeros((4, *world.active.shape), jnp.int32)
    carry = (seeds, before, headings, _waiting(world, seeds))
    boards, _, headings, _ = lax.while_loop(lambda carry: jnp.any(carry[-1]), chunk, carry)
    return headings.T, world.active & ~_waiting(world, boards)


def _relax(world: _World, passable: Any, boards: _Boards, before: Any) -> _Boards:
    """Adds the poses one action further; through slow cells, from the boards one action ago."""
    layers = []
    for level, now in enumerate(boards):
        arrivals = now
        if world.slow is not None:
            fast, slow = world.open[level], world.slow[level]
            arrivals = tuple(
                (new & fast) | (old & slow) for new, old in zip(now, before[level], strict=True)
            )
        steps = _behind(arrivals)
        grown = []
        for heading in range(4):
            board = now[heading] | now[heading - 1] | now[(heading + 1) % 4] | steps[heading]
            if level < len(world.gates):
                board |= world.gates[level][heading] & boards[level + 1][heading]
            grown.append(board & passable[level])
        layers.append(tuple(grown))
    return tuple(layers)


def _behind(boards: tuple[Board, ...]) -> tuple[Board, ...]:
    """Moves poses word[H, ...], one board a heading, one cell back."""
    edges = [(0, 0, 0)] * (boards[0].ndim - 1)
    zero = jnp.zeros((), boards[0].dtype)
    return (
        boards[0] >> 1,
        lax.pad(boards[1], zero, [(-1, 1, 0), *edges]),
        boards[2] << 1,
        lax.pad(boards[3], zero, [(1, -1, 0), *edges]),
    )


def _missing(world: _World, boards: _Boards) -> jax.Array:
    """Returns int32[4, N]: 1 for each heading, at the lane's cell and layer, not yet reached."""
    row = world.row[None]
    words = jnp.stack(
        [
            jnp.stack([jnp.take_along_axis(board, row, axis=0)[0] for board in level])
            for level in boards
        ]
    )
    own = words[0]
    for level in range(1, len(boards)):
        own = jnp.where(world.layer == level, words[level], own)
    return (~(own >> world.column.astype(own.dtype)) & 1).astype(jnp.int32)


def _waiting(world: _World, boards: _Boards) -> jax.Array:
    """Returns bool[N]: which lanes' poses were not reached yet."""
    lanes = jnp.arange(len(world.active))
    return world.active & (_missing(world, boards)[world.direction, lanes] != 0)
