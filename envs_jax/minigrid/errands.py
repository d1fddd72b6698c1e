"""How to get a subgoal done when keys are to be fetched and objects to be taken out of the way.

Nothing is remembered. From the world as it stands, what is in the way of the subgoal is followed
back to something that can be done at once: `_within_reach` turns "pick up the ball" into "pick up
the key of the door before it", and that into "pick up the box before the key". With full hands
comes first "drop it where it blocks nothing". Only this last subgoal is planned for, by `planner`.
What stands in the way is chosen by where the walls and objects are, not by where in its region the
agent is, so following the advice does not change it.

In a crowded room there may be no cell in which something put down is in nobody's way. Any rule
would in some such room move the same things to and fro for ever, so there it is left to chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import (
    DROP,
    FORWARD,
    LEFT,
    PICKUP,
    PORTABLE,
    RIGHT,
    TOGGLE,
    at_index,
    cell_index,
    front_index,
    is_kind,
)
from envs_jax.minigrid.planner import Board, Terrain
from envs_jax.minigrid.regions import (
    around,
    beside,
    cell_board,
    dispensable,
    first_cell,
    nearest,
    spread,
)
from envs_jax.minigrid.state import CONTENTS_SHIFT, GridState
from envs_jax.minigrid.subgoals import Subgoal, inner
from jaxact.compaction import while_loop_for_few
from jaxact.pomdp import ExpertAction

_WALKABLE = 1 << tiles.EMPTY | 1 << tiles.FLOOR | 1 << tiles.OPEN_DOOR | 1 << tiles.OPEN_LOCKED_DOOR
_COLOR_MASK = 255 - tiles.TYPE_MASK
# How many obstacles behind obstacles are followed back.
_DEPTH = 8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Map:
    """Bitboards word[H] of the cells that matter, given what is held and what is permitted.

    Attributes:
      walkable: cells to step on.
      closed: doors that may be opened without a key, and boxes that may be opened to get past.
      fitting: locked doors that the key in hand opens.
      locks: other locked doors of which there is a key somewhere.
      sealed: locked doors of which there is none.
      loose: objects that may be taken away.
      free: cells in which something can be put down.
      harmless: those of them in which it is in nobody's way.
      some: a random half of all cells.
      near: cells that can be acted on without opening a lock.
      far: cells that can be acted on, if need be with the key in hand.
    """

    walkable: Board
    closed: Board
    fitting: Board
    locks: Board
    sealed: Board
    loose: Board
    free: Board
    harmless: Board
    some: Board
    near: Board
    far: Board

    @property
    def passable(self) -> Board:
        """Cells to get through without moving anything."""
        return self.walkable | self.closed | self.fitting


class _Step(NamedTuple):
    """Something to do on the way to a subgoal.

    Attributes:
      cells: where to act; none if there is nothing that helps.
      action: int32 scalar, what to do there.
      is_for_key: bool scalar, whether `cells` are keys, or boxes to be opened for the key in them.
      locks: locked doors that may be in the way of it.
    """

    cells: Board
    action: jax.Array
    is_for_key: jax.Array
    locks: Board


def errand_expert(key: jax.Array, subgoal: Subgoal, state: GridState, height: int) -> ExpertAction:
    """Advises the next action towards a subgoal.

    If the subgoal is within reach, doors without lock included, the advice is the first action of a
    shortest plan. Otherwise it is that of a shortest plan for the first thing in the way. This
    solves the task, but is not always the shortest solution.

    Args:
      key: PRNG key, a fresh one at each step; it matters only in crowded rooms.
      subgoal: what is to be done.
      state: the world.
      height: cells of the grid along y.

    Returns:
      An int32 action of `GridWorld`. It is not valid where no way was found.
    """
    world = _survey(key, subgoal, state)
    return _advise(subgoal, world, _within_reach(subgoal, world, state), state, height)


def first_errand_expert(
    key: jax.Array, subgoals: Sequence[Subgoal], state: GridState, height: int
) -> ExpertAction:
    """Advises the next action towards the first subgoal for which there is something to do.

    To put down what is held, so as to see what can be done then, counts only where that has to be.
    Where nothing counts, the advice is that of `errand_expert` for the very first subgoal.

    Args:
      key: PRNG key; see `errand_expert`.
      subgoals: what is to be done, most wanted first.
      state: the world.
      height: cells of the grid along y.

    Returns:
      An int32 action of `GridWorld`. It is not valid where no way was found.
    """

    def prepare(subgoal: Subgoal) -> tuple[Subgoal, _Map, _Step]:
        world = _survey(key, subgoal, state)
        return subgoal, world, _within_reach(subgoal, world, state)

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *subgoals)
    prepared = jax.vmap(prepare)(stacked)
    is_possible = jnp.any(prepared[2].cells != 0, axis=1) | stacked.must_drop
    subgoal, world, step = jax.tree.map(lambda leaf: leaf[jnp.argmax(is_possible)], prepared)
    return _advise(subgoal, world, step, state, height)


def _advise(
    subgoal: Subgoal, world: _Map, step: _Step, state: GridState, height: int
) -> ExpertAction:
    """Returns the first action of a shortest plan for a step."""
    hands_full = state.carrying != 0
    must_drop = hands_full & (
        ~_any(step.cells) | (step.action == PICKUP) & _any(step.cells & world.near)
    )
    target = jnp.where(must_drop, _drop_cells(subgoal, step.cells, world), step.cells)
    stands = subgoal.stands & (step.action == subgoal.action) & ~must_drop
    terrain = Terrain(
        open=world.walkable[None],
        slow=(world.closed | world.fitting)[None],
        gates=jnp.zeros((0, height), world.walkable.dtype),
    )
    plan = planner.plan(terrain, target, state.position, state.direction, stands=stands)

    ahead = at_index(state.tiles, front_index(state, height)) & tiles.TYPE_MASK
    arrival = jnp.where(step.is_for_key & (ahead == tiles.BOX), TOGGLE, step.action)
    arrival = jnp.where(must_drop, DROP, arrival)
    moves = jnp.array([LEFT, RIGHT, FORWARD, TOGGLE], jnp.int32)
    action = jnp.where(
        plan.action == planner.ARRIVED, arrival, moves[jnp.minimum(plan.action, planner.ACT)]
    )
    return ExpertAction(action.astype(jnp.int32), plan.reached)


def _survey(key: jax.Array, subgoal: Subgoal, state: GridState) -> _Map:
    cells = inner(state.tiles)
    kinds, colors = cells & tiles.TYPE_MASK, cells & _COLOR_MASK
    locked = kinds == tiles.LOCKED_DOOR
    fits = locked & (state.carrying == colors | tiles.KEY)
    nothing = jnp.zeros_like(subgoal.cells)
    walkable = planner.pack(is_kind(cells, _WALKABLE)) & ~subgoal.forbidden
    closed = jnp.where(subgoal.may_open, planner.pack(kinds == tiles.CLOSED_DOOR), nothing)
    closed |= subgoal.fragile
    fitting = jnp.where(subgoal.may_open, planner.pack(fits), nothing)
    has_key = _has_key(colors, state)
    locks = planner.pack(locked & ~fits & has_key)
    here = cell_board(state.position, subgoal.cells)
    near = spread(here, walkable | closed)
    far = spread(near, walkable | closed | fitting)
    free = planner.pack(cells == tiles.EMPTY_TILE) & beside(near) & ~subgoal.forbidden
    harmless = dispensable(walkable | closed | fitting | locks) & ~(subgoal.reserved | here)
    return _Map(
        walkable=walkable,
        closed=closed,
        fitting=fitting,
        locks=locks,
        sealed=planner.pack(locked & ~fits & ~has_key),
        loose=jnp.where(subgoal.may_move, planner.pack(is_kind(cells, PORTABLE)), nothing),
        free=free,
        harmless=free & harmless,
        some=jax.random.bits(key, free.shape, free.dtype),
        near=near | beside(near),
        far=far | beside(far),
    )


def _has_key(colors: jax.Array, state: GridState) -> jax.Array:
    """Returns bool[W, H]: whether there is a key of each cell's colour, in a box or in the hand."""
    contents = _contains_key(inner(state.tiles), inner(state.marks))
    held = _contains_key(state.carrying, state.carrying_mark)
    found = lax.reduce(jnp.uint8(1) << contents, jnp.uint8(0), lax.bitwise_or, (0, 1))
    found |= jnp.uint8(1) << held
    return found >> (colors >> tiles.COLOR_SHIFT) + 1 & 1 != 0


def _keys(state: GridState, color: jax.Array) -> Board:
    """Returns the keys of `color`, the high bits of a tile, and the boxes with one in them."""
    contents = _contains_key(inner(state.tiles), inner(state.marks))
    return planner.pack(contents == (color >> tiles.COLOR_SHIFT) + 1)


def _contains_key(tile: jax.Array, mark: jax.Array) -> jax.Array:
    """Returns, as a colour + 1, which key a tile is or a box contains; 0 for none. uint8."""
    kind = tile & tiles.TYPE_MASK
    content = (mark >> CONTENTS_SHIFT).astype(jnp.uint8)
    key = jnp.where(kind == tiles.KEY, (tile >> tiles.COLOR_SHIFT) + 1, jnp.uint8(0))
    return jnp.where(kind == tiles.BOX, content, key)


def _within_reach(subgoal: Subgoal, world: _Map, state: GridState) -> _Step:
    """Returns the subgoal, or else what is to be done first and can be done at once."""
    nothing = jnp.zeros_like(subgoal.cells)

    # With the way cleared only once it is needed, what was picked up would be put down for it and
    # then picked up again, for ever.
    is_cut_off = _any(subgoal.destination) & ~_any(subgoal.destination & world.near)
    # In a crowded room that order, too, would never come to an end, so at times it is reversed.
    is_cut_off &= _any(world.harmless) | (world.some[0] & 1 != 0)
    can_be_done = jnp.where(subgoal.action == TOGGLE, subgoal.cells & ~world.sealed, subgoal.cells)
    first = _Step(
        cells=jnp.where(is_cut_off, subgoal.destination, can_be_done),
        action=jnp.where(is_cut_off, DROP, subgoal.action),
        is_for_key=jnp.bool_(False),
        locks=world.locks,
    )
    step, _ = while_loop_for_few(_is_stuck, _go_back, (first, jnp.int32(0)), (world, state))
    return step._replace(cells=jnp.where(_any(step.cells), _ready(step, world), nothing))


def _is_stuck(carry: tuple[_Step, jax.Array], constants: tuple[_Map, GridState]) -> jax.Array:
    """Says whether a step, so many steps before the subgoal, is still to be followed back."""
    (step, depth), (world, _) = carry, constants
    return ~_any(_ready(step, world)) & _any(step.cells) & (depth < _DEPTH)


def _go_back(
    carry: tuple[_Step, jax.Array], constants: tuple[_Map, GridState]
) -> tuple[_Step, jax.Array]:
    """Returns what is to be done before a step; see `_is_stuck`."""
    (step, depth), (world, state) = carry, constants
    nothing = jnp.zeros_like(step.cells)
    obstacles = _obstacles(step, world)
    cell = first_cell(obstacles)
    blocked = cell_board(cell, nothing) & obstacles
    is_lock = _any(blocked & step.locks)
    color = at_index(state.tiles, cell_index(cell, len(nothing))) & _COLOR_MASK
    same_color = planner.pack(inner(state.tiles) & _COLOR_MASK == color)
    before = _Step(
        cells=jnp.where(is_lock, _keys(state, color), blocked),
        action=jnp.int32(PICKUP),
        is_for_key=is_lock,
        # A key is not looked for behind the door that it opens.
        locks=jnp.where(is_lock, step.locks & ~same_color, step.locks),
    )
    return before, depth + 1


def _ready(step: _Step, world: _Map) -> Board:
    """Returns the step's cells at which it can be done now."""
    is_toggle = step.action == TOGGLE
    return step.cells & world.far & ~jnp.where(is_toggle, step.locks, jnp.zeros_like(step.cells))


def _obstacles(step: _Step, world: _Map) -> Board:
    """Returns what can be acted on and is in the way of the step, behind it as little as can be.

    A way past objects is preferred to one through locked doors.
    """
    nothing = jnp.zeros_like(step.cells)
    shut = jnp.where(step.action == TOGGLE, step.cells & step.locks & world.far, nothing)
    past_objects = nearest(step.cells, world.passable, world.loose, world.far)
    seeds = jnp.where(_any(past_objects), nothing, step.cells)
    past_locks = nearest(seeds, world.passable, world.loose | step.locks, world.far)
    return jnp.where(_any(shut), shut, jnp.where(_any(past_objects), past_objects, past_locks))


def _drop_cells(subgoal: Subgoal, cells: Board, world: _Map) -> Board:
    """Returns the best cells there are to put down what is held, with `cells` to come next."""
    best = world.free
    # The best come last.
    for choice in (
        world.free & world.some,
        world.harmless & ~around(cells),
        world.harmless & ~around(cells | subgoal.cells),
    ):
        best = jnp.where(_any(choice), choice, best)
    return best


def _any(board: Board) -> jax.Array:
    return jnp.any(board != 0)
