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
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxact.compaction import together

# The first three are MiniGrid's own actions; ACT is for the caller to name (toggle, pickup);
# ARRIVED says that the pose is a goal already.
LEFT, RIGHT, FORWARD, ACT, ARRIVED = range(5)

MAX_WIDTH = 32
# Actions between two looks at whether the search is over.
_LEAP = 4
# When one lane in so many is left, the search goes on with these alone; if there were many at all.
_FEW, _MANY = 8, 256

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


def behind(boards: Sequence[Board]) -> tuple[Board, Board, Board, Board]:
    """Moves poses, four boards word[H, ...] for the four headings, one cell back."""
    edges = [(0, 0, 0)] * (boards[0].ndim - 1)
    zero = jnp.zeros((), boards[0].dtype)
    return (
        boards[0] >> 1,
        lax.pad(boards[1], zero, [(-1, 1, 0), *edges]),
        boards[2] << 1,
        lax.pad(boards[3], zero, [(1, -1, 0), *edges]),
    )


def plan(
    terrain: Terrain,
    targets: Board,
    position: jax.Array,
    direction: jax.Array,
    layer: jax.Array | int = 0,
    *,
    stands: jax.Array | bool = False,
    active: jax.Array | bool = True,
) -> Plan:
    """Finds a shortest plan from a pose to any goal pose.

    Turning left, turning right, stepping forward and acting cost one action each. Among equally
    short plans those that begin with a turn come first. Under `jax.vmap` all lanes search together,
    until the last one has arrived or is known not to.

    Args:
      terrain: where one may walk.
      targets: word[H], cells. Goals are the poses, of every layer, that face one of them.
      position: int32[2], (x, y).
      direction: int32 scalar, 0 right, 1 down, 2 left, 3 up.
      layer: int32 scalar, the layer one is in.
      stands: bool scalar; goals are then the poses on the cells instead, in any heading.
      active: bool scalar; a lane that is not is not waited for, and its plan is not reached.

    Returns:
      The plan's first action and length.
    """
    layer = jnp.asarray(layer, jnp.int32)
    flags = jnp.asarray(stands), jnp.asarray(active)
    headings, reached = _search(terrain, targets, position, direction, layer, *flags)
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
      here: L boards: the cell that the lane is in, in its layer.
      direction: int32[N], the lane's heading.
    """

    open: tuple[Board, ...]
    slow: tuple[Board, ...] | None
    gates: tuple[tuple[Board, ...], ...]
    goals: tuple[Board, ...]
    here: tuple[Board, ...]
    direction: jax.Array


# Poses reached, as boards[layer][heading].
_Boards = tuple[tuple[Board, ...], ...]
# Those, and those of one action ago: nothing, where there are no slow cells.
_Reached = tuple[_Boards, _Boards]


@together
def _search(
    terrain: Terrain,
    targets: Board,
    position: jax.Array,
    direction: jax.Array,
    layer: jax.Array,
    stands: jax.Array,
    active: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Searches for N lanes at once; every argument has a leading axis N.

    Returns:
      int32[N, 4], distances of the four headings at each lane's cell and layer, exact up to that of
      its own heading and no less than that beyond; and bool[N], whether its pose was reached.
    """
    opens, slows, gates, cells = (
        jnp.moveaxis(boards, 0, -1)
        for boards in (terrain.open, terrain.slow, terrain.gates, targets)
    )
    row = jnp.arange(opens.shape[1], dtype=jnp.int32)[:, None] == position[:, 1]
    nowhere = jnp.zeros((), opens.dtype)
    cell = jnp.where(row, jnp.ones_like(nowhere) << position[:, 0].astype(opens.dtype), nowhere)
    world = _World(
        open=tuple(opens),
        slow=tuple(slows),
        gates=tuple(behind((board,) * 4) for board in gates),
        goals=tuple(jnp.where(stands, cells, board) for board in behind((cells,) * 4)),
        here=tuple(jnp.where(layer == level, cell, nowhere) for level in range(len(opens))),
        direction=direction,
    )
    # Few worlds have doors; a look at all lanes at once spares the others layers and slow cells.
    has_slow, has_gates = (
        jnp.any(active & jnp.any(boards != 0, axis=(1, 2)))
        for boards in (terrain.slow, terrain.gates)
    )
    variants = [
        functools.partial(_search_variant, world, layer, active, *choice)
        for choice in itertools.product((False, True), repeat=2)
    ]
    if world.gates:
        variant = has_slow.astype(jnp.int32) + 2 * has_gates.astype(jnp.int32)
    else:
        variant, variants = has_slow.astype(jnp.int32), variants[:2]
    distances, reached = lax.switch(variant, variants)
    return distances.T, reached


def _search_variant(
    world: _World, layer: jax.Array, active: jax.Array, has_gates: bool, has_slow: bool
) -> tuple[jax.Array, jax.Array]:
    """Searches as `_search` does, without what there is not."""
    if not has_slow:
        world = world._replace(slow=None)
    if not has_gates:
        world = _own_layer(world, layer)
    boards = tuple(tuple(goal & cells for goal in world.goals) for cells in _passable(world))
    begin = boards, jax.tree.map(jnp.zeros_like, boards) if has_slow else ()
    waits = active & _is_missing(world, boards)
    distances, missed = _arrive(world, begin, jnp.zeros(active.shape, jnp.int32), waits)
    return distances, active & ~missed


def _own_layer(world: _World, layer: jax.Array) -> _World:
    """Returns the world with each lane's own layer, int32[N], as the only one."""

    def own(boards: tuple[Board, ...]) -> tuple[Board]:
        chosen = boards[0]
        for level, board in enumerate(boards):
            chosen = jnp.where(layer == level, board, chosen)
        return (chosen,)

    return world._replace(
        open=own(world.open),
        slow=None if world.slow is None else own(world.slow),
        gates=(),
        here=own(world.here),
    )


def _arrive(
    world: _World, begin: _Reached, actions: jax.Array, waits: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Searches until the pose of every lane that waits has been reached or is known not to be.

    First by so many actions at a time, without a look at the lanes in between, to the last such
    moment before each lane's pose is reached; then once more from there, action by action. When few
    lanes are left, the search goes on with these alone.

    Args:
      world: the terrains and poses.
      begin: the poses reached so far.
      actions: int32[N], in so many actions.
      waits: bool[N], the lanes whose poses were not reached.

    Returns:
      int32[4, N], distances as of `_search`, and bool[N], whether the lane's pose was not reached.
    """
    size = waits.shape[0]
    few = size // _FEW if size >= _MANY else 0
    grow = functools.partial(_grow, world, _passable(world))

    def leap(carry: Any) -> Any:
        before, actions, waits = carry
        after = lax.fori_loop(0, _LEAP, lambda _, reached: grow(reached), before)
        pairs = zip(jax.tree.leaves(before[0]), jax.tree.leaves(after[0]), strict=True)
        changed = functools.reduce(jnp.bitwise_or, (old ^ new for old, new in pairs))
        waits &= _has_any(changed) & _is_missing(world, after[0])
        return _where(waits, after, before), actions + _LEAP * waits.astype(jnp.int32), waits

    def step(_: int, carry: Any) -> Any:
        reached, distances = carry
        return grow(reached), distances + _missing(world, reached[0])

    def many_wait(carry: Any) -> jax.Array:
        return jnp.sum(carry[-1], dtype=jnp.int32) > few

    reached, actions, waits = lax.while_loop(many_wait, leap, (begin, actions, waits))
    distances = jnp.broadcast_to(actions, (4, size))
    last, distances = lax.fori_loop(0, _LEAP, step, (reached, distances))
    missed = _is_missing(world, last[0])
    if few:
        lanes = jnp.nonzero(waits, size=few, fill_value=size)[0].astype(jnp.int32)
        part, begun, spent = jax.tree.map(
            lambda leaf: jnp.take(leaf, lanes, axis=-1, mode="clip"), (world, reached, actions)
        )
        distances_of_few, missed_of_few = _arrive(part, begun, spent, lanes < size)
        distances = distances.at[:, lanes].set(distances_of_few, mode="drop")
        missed = missed.at[lanes].set(missed_of_few, mode="drop")
    return distances, missed


def _where(condition: jax.Array, this: _Reached, that: _Reached) -> _Reached:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), this, that)


def _passable(world: _World) -> tuple[Board, ...]:
    if world.slow is None:
        return world.open
    return tuple(a | b for a, b in zip(world.open, world.slow, strict=True))


def _grow(world: _World, passable: tuple[Board, ...], reached: _Reached) -> _Reached:
    """Adds the poses one action further; through slow cells, from the boards one action ago."""
    boards, before = reached
    layers = []
    for level, now in enumerate(boards):
        arrivals = now
        if world.slow is not None:
            fast, slow = world.open[level], world.slow[level]
            arrivals = tuple(
                (new & fast) | (old & slow) for new, old in zip(now, before[level], strict=True)
            )
        steps = behind(arrivals)
        grown = []
        for heading in range(4):
            board = now[heading] | now[heading - 1] | now[(heading + 1) % 4] | steps[heading]
            if level < len(world.gates):
                board |= world.gates[level][heading] & boards[level + 1][heading]
            grown.append(board & passable[level])
        layers.append(tuple(grown))
    return tuple(layers), () if world.slow is None else boards


def _missing(world: _World, boards: _Boards) -> jax.Array:
    """Returns int32[4, N]: 1 for each heading, at the lane's cell and layer, not yet reached."""
    missing = []
    for heading in range(4):
        there = [board[heading] & cell for board, cell in zip(boards, world.here, strict=True)]
        missing.append(~_has_any(functools.reduce(jnp.bitwise_or, there)))
    return jnp.stack(missing).astype(jnp.int32)


def _has_any(board: Board) -> jax.Array:
    """Returns bool[N]: whether there is anything on a lane's board, word[H, N].

    Row by row: that runs along the lanes, where a reduction goes through the rows of one lane.
    """
    return functools.reduce(jnp.bitwise_or, [board[row] for row in range(len(board))]) != 0


def _is_missing(world: _World, boards: _Boards) -> jax.Array:
    """Returns bool[N]: whether the lane's pose was not yet reached."""
    lanes = jnp.arange(len(world.direction), dtype=jnp.int32)
    return _missing(world, boards)[world.direction, lanes] != 0
