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

from jaxact.compaction import together

# The first three are MiniGrid's own actions; ACT is for the caller to name (toggle, pickup);
# ARRIVED says that the pose is a goal already.
LEFT, RIGHT, FORWARD, ACT, ARRIVED = range(5)

MAX_WIDTH = 32
# Relaxations between two looks at whether the search is over.
_CHUNK = 4
# When one lane in so many is left, the search goes on with these alone.
_FEW = 8

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Guide:
    """The beginnings of shortest plans from all poses, in a world that does not change.

    Attributes:
      left: word[4, H], poses from which a plan begins with a turn to the left.
      right: word[4, H], those of the others from which it begins with a turn to the right.
      near: word[4, H], poses from which few actions lead to a goal pose.
      reached: word[H], cells from which there is a plan.
    """

    left: Board
    right: Board
    near: Board
    reached: Board


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


def holds(poses: Board, position: jax.Array, direction: jax.Array) -> jax.Array:
    """Says whether word[4, H] has the pose at `position`, int32[2], in `direction`; bool scalar."""
    return contains(poses[direction], position)


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
    headings, reached = _search(terrain, goals, position, direction, layer, jnp.asarray(active))
    distance = headings[direction]
    left, right = headings[(direction + 3) % 4], headings[(direction + 1) % 4]
    ahead = position + jnp.array([[1, 0], [0, 1], [-1, 0], [0, -1]], jnp.int32)[direction]
    straight = jnp.where(contains(terrain.open[layer], ahead), FORWARD, ACT)
    action = jnp.select(
        [distance == 0, left < distance, right < distance], [ARRIVED, LEFT, RIGHT], straight
    )
    return Plan(action.astype(jnp.int32), distance, reached)


def guide(walkable: Board, goals: Board, near: int) -> Guide:
    """Finds the beginnings of shortest plans from everywhere, of those `plan` would find.

    Args:
      walkable: word[H], cells entered by a step forward; there are no others to get through.
      goals: word[4, H], goal poses.
      near: how many actions to a goal pose are few.
    """
    return _guide(walkable, goals, jnp.asarray(near, jnp.int32))


@together
def _guide(walkable: Board, goals: Board, near: jax.Array) -> Guide:
    """Guides N lanes at once; every argument has a leading axis N."""
    open_ = walkable.T

    def grow(carry: tuple[jax.Array, tuple[Board, ...], jax.Array]) -> Any:
        actions, (now, left, right, close), _ = carry
        before, after = jnp.roll(now, 1, axis=0), jnp.roll(now, -1, axis=0)
        new = (before | after | jnp.stack(_behind(tuple(now)))) & open_ & ~now
        left, right = left | new & before, right | new & after & ~before
        close = jnp.where(actions < near, close | new, close)
        return actions + 1, (now | new, left, right, close), jnp.any(new != 0)

    seeds = jnp.moveaxis(goals, 0, -1) & open_
    nothing = jnp.zeros_like(seeds)
    close = jnp.where(near >= 0, seeds, nothing)
    begin = (jnp.int32(0), (seeds, nothing, nothing, close), jnp.bool_(True))
    _, boards, _ = lax.while_loop(lambda carry: carry[-1], grow, begin)
    reached, left, right, close = (jnp.moveaxis(board, -1, 0) for board in boards)
    return Guide(left, right, close, reached[:, 0])


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
# The boards; those of one action ago, nothing without slow cells; int32[4, N], the distances so far
# of the four headings; bool[N], which lanes wait.
_Search = tuple[_Boards, _Boards, jax.Array, jax.Array]


@together
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
    # Few worlds have doors; a look at all lanes at once spares the others layers and slow cells.
    has_slow, has_gates = (
        jnp.any(active[:, None, None] & jnp.any(boards != 0, axis=1))
        for boards in (terrain.slow, terrain.gates)
    )
    world = jax.tree.map(
        lambda all_layers, own: jnp.where(has_gates, all_layers, own), layered, _own_layer(layered)
    )
    few = len(layer) // _FEW
    levels = [1, len(opens)] if gates.shape[0] else [1]
    variants = [(level, has_slow) for level in levels for has_slow in (False, True)]
    variant = has_slow.astype(jnp.int32) + 2 * has_gates.astype(jnp.int32)
    carry = lax.switch(variant, [functools.partial(_begin, world, few, *v) for v in variants])
    headings, missed = carry[2], _waiting(world, carry[0])
    if few > 0:
        lanes, headings_of_few, missed_of_few = _go_on(world, few, carry)
        headings = headings.at[:, lanes].set(headings_of_few, mode="drop")
        missed = missed.at[lanes].set(missed_of_few, mode="drop")
    return headings.T, active & ~missed


def _own_layer(world: _World) -> _World:
    """Returns the world with each lane's layer as the first, and nothing in the others."""
    lanes = jnp.arange(len(world.layer))

    def alone(boards: tuple[Board, ...]) -> tuple[Board, ...]:
        own = jnp.stack(boards)[world.layer, :, lanes].T
        return (own, *(jnp.zeros_like(own) for _ in boards[1:]))

    assert world.slow is not None
    return world._replace(
        open=alone(world.open),
        slow=alone(world.slow),
        gates=jax.tree.map(jnp.zeros_like, world.gates),
        layer=jnp.zeros_like(world.layer),
    )


def _begin(world: _World, few: int, levels: int, has_slow: bool) -> _Search:
    """Searches in so many layers, with or without slow cells, until only few lanes wait."""
    assert world.slow is not None
    part = world._replace(
        open=world.open[:levels],
        slow=world.slow[:levels] if has_slow else None,
        gates=world.gates[: levels - 1],
    )
    boards = tuple(tuple(goal & cells for goal in world.goals) for cells in _passable(part))
    before: Any = jax.tree.map(jnp.zeros_like, boards) if has_slow else ()
    headings = jnp.zeros((4, len(world.active)), jnp.int32)
    carry = _grow(part, (boards, before, headings, _waiting(part, boards)), few)
    boards, before, headings, waits = carry
    rest = jax.tree.map(jnp.zeros_like, (boards[0],) * (len(world.open) - levels))
    # Where there are no slow cells, it does not matter what is taken for the boards before.
    return (*boards, *rest), (*(before if has_slow else boards), *rest), headings, waits


def _go_on(world: _World, few: int, carry: _Search) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Searches on in the few lanes that wait, by themselves.

    Returns:
      int32[few], which lanes they are (others than there are, where they are fewer); int32[4, few],
      their distances; and bool[few], whether their poses were not reached.
    """
    size = len(world.active)
    lanes = jnp.nonzero(carry[-1], size=few, fill_value=size)[0].astype(jnp.int32)
    part, (boards, before, headings, waits) = jax.tree.map(
        lambda leaf: jnp.take(leaf, lanes, axis=-1, mode="clip"), (world, carry)
    )
    carry = _grow(part, (boards, before, headings, waits & (lanes < size)), 0)
    return lanes, carry[2], _waiting(part, carry[0])


def _passable(world: _World) -> tuple[Board, ...]:
    if world.slow is None:
        return world.open
    return tuple(a | b for a, b in zip(world.open, world.slow, strict=True))


def _grow(world: _World, carry: _Search, few: int) -> _Search:
    """Grows the reached poses for as long as more than a few lanes wait."""
    passable = _passable(world)

    def once(_: int, carry: Any) -> Any:
        boards, before, headings = carry
        grown = _relax(world, passable, boards, before)
        before = before if world.slow is None else boards
        return grown, before, headings + _missing(world, boards)

    def chunk(carry: Any) -> Any:
        start, before, headings, _ = carry
        boards, before, headings = lax.fori_loop(0, _CHUNK, once, (start, before, headings))
        pairs = zip(jax.tree.leaves(start), jax.tree.leaves(boards), strict=True)
        changed = functools.reduce(jnp.bitwise_or, (old ^ new for old, new in pairs))
        growing = jnp.any(changed != 0, axis=0)
        return boards, before, headings, _waiting(world, boards) & growing

    def many_wait(carry: Any) -> jax.Array:
        return jnp.sum(carry[-1], dtype=jnp.int32) > few

    return lax.while_loop(many_wait, chunk, carry)


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
