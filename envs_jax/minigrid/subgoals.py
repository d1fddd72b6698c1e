"""What a task wants done next, as sets of cells; how to get there is `errands`' concern."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import DONE, DROP, PICKUP, PORTABLE, TOGGLE, is_kind
from envs_jax.minigrid.instructions import MAX_CLAUSES, Program, Progress
from envs_jax.minigrid.planner import Board
from envs_jax.minigrid.regions import beside
from envs_jax.minigrid.state import PADDING, GridState

_SHUT_DOORS = 1 << tiles.CLOSED_DOOR | 1 << tiles.LOCKED_DOOR


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Subgoal:
    """An action to be taken at one of some cells. Boards are word[H], see `planner`.

    Without cells there is nothing to do but to drop what is held, unless to find them.

    Attributes:
      cells: where to act; one of them is to be faced or, with `stands`, to be stood on.
      action: int32 scalar, what to do there.
      stands: bool scalar.
      forbidden: cells not to step on.
      reserved: cells in which nothing should be put down on the way.
      destination: cells of which one is to be faced afterwards, with in hand what is picked up;
        none where that is all.
      fragile: boxes to be got past by opening them, which destroys them.
      must_drop: bool scalar, whether what is held has to be put down first.
      may_move: bool scalar, whether objects may be taken out of the way.
      may_open: bool scalar, whether doors other than `cells` may be opened.
    """

    cells: Board
    action: jax.Array
    stands: jax.Array
    forbidden: Board
    reserved: Board
    destination: Board
    fragile: Board
    must_drop: jax.Array
    may_move: jax.Array
    may_open: jax.Array

    @classmethod
    def of(
        cls,
        cells: Board,
        action: jax.Array | int,
        *,
        stands: jax.Array | bool = False,
        forbidden: Board | None = None,
        reserved: Board | None = None,
        destination: Board | None = None,
        fragile: Board | None = None,
        must_drop: jax.Array | bool = False,
        may_move: jax.Array | bool = True,
        may_open: jax.Array | bool = True,
    ) -> Subgoal:
        """Returns the subgoal; what is not given restricts nothing."""
        nothing = jnp.zeros_like(cells)
        return cls(
            cells=cells,
            action=jnp.asarray(action, jnp.int32),
            stands=jnp.asarray(stands, jnp.bool_),
            forbidden=nothing if forbidden is None else forbidden,
            reserved=nothing if reserved is None else reserved,
            destination=nothing if destination is None else destination,
            fragile=nothing if fragile is None else fragile,
            must_drop=jnp.asarray(must_drop, jnp.bool_),
            may_move=jnp.asarray(may_move, jnp.bool_),
            may_open=jnp.asarray(may_open, jnp.bool_),
        )


def inner(plane: jax.Array) -> jax.Array:
    """Cuts the grid [W, H] out of a padded plane."""
    return plane[PADDING:-PADDING, PADDING:-PADDING]


def instruction_subgoal(
    program: Program, progress: Progress, ghosts: jax.Array, state: GridState
) -> Subgoal:
    """Returns what the first clause that counts and is not done wants next.

    Args:
      program: the instruction.
      progress: how far it was followed.
      ghosts: uint32[beliefs, H], see `instructions.believe`.
      state: the world; cells of type `UNSEEN` may be anything.
    """
    clauses = program.go_to | program.open | program.pick_up | program.put_next
    sooner = jnp.where(program.later == 0, clauses, clauses & ~program.later) & ~progress.done
    pending = jnp.where(sooner == 0, clauses & ~progress.done, sooner)
    clause = pending & (~pending + 1)
    number = jax.lax.population_count((clause - 1) & (1 << MAX_CLAUSES) - 1)
    is_open, is_pick_up, is_put_next, is_strict = (
        kind & clause != 0
        for kind in (program.open, program.pick_up, program.put_next, program.strict)
    )

    cells, marks = inner(state.tiles), inner(state.marks).astype(jnp.uint32)
    places = planner.pack(marks >> number & 1 != 0)
    things = planner.pack(marks >> (number + MAX_CLAUSES) & 1 != 0)
    believed = places ^ _ghosts_of(ghosts, number).astype(places.dtype)
    empty, loose = planner.pack(cells == tiles.EMPTY_TILE), planner.pack(is_kind(cells, PORTABLE))
    shut = things & planner.pack(is_kind(cells, _SHUT_DOORS))
    boxes = planner.pack(cells & tiles.TYPE_MASK == tiles.BOX)
    unseen = planner.pack(cells == tiles.UNSEEN)

    held = state.carrying_mark.astype(jnp.uint32) >> number
    holds, holds_place = held >> MAX_CLAUSES & 1 != 0, held & 1 != 0
    edge, nothing = beside(places), jnp.zeros_like(places)
    room = edge & empty
    has_room = jnp.any(room != 0)
    is_crowded = jnp.any(places != 0) & jnp.all(edge & (empty | unseen) == 0)
    # Walls are among the things when a description names no more than their colour.
    movable = things & loose
    # What is to be picked up, found or put something next to may be in hand.
    in_hand = jnp.where(is_put_next, holds_place & ~holds, holds_place | holds)
    # A place is not put down where nothing can be put next to it.
    no_room = jnp.where(in_hand, ~beside(empty), nothing)
    # A thing is not fetched before it is known where to.
    put_cells = jnp.select(
        [is_crowded, has_room & holds, has_room | in_hand], [edge & loose, room, movable], nothing
    )
    # An open door counts as well, but has to be shut first.
    doors = jnp.where(jnp.any(shut != 0), shut, things)
    wanted = jnp.select(
        [is_put_next, is_open, is_pick_up & ~holds, is_pick_up],
        [put_cells, doors, movable, nothing],
        believed,
    )
    return Subgoal.of(
        wanted,
        jnp.select(
            [is_put_next & holds & ~is_crowded, is_put_next | is_pick_up, is_open],
            [jnp.int32(DROP), jnp.int32(PICKUP), jnp.int32(TOGGLE)],
            jnp.int32(DONE),
        ),
        reserved=jnp.where(is_put_next, edge | no_room, nothing),
        destination=jnp.where(is_put_next & ~holds, room, nothing),
        fragile=jnp.where(is_strict & is_pick_up, boxes & ~things, nothing),
        must_drop=in_hand & jnp.all(wanted == 0),
        may_move=~(is_strict & is_pick_up),
        may_open=~(is_strict & is_open),
    )


def _ghosts_of(ghosts: jax.Array, number: jax.Array) -> jax.Array:
    """Returns uint32[H], where clause `number` errs; nowhere if it has no beliefs."""
    beliefs, height = ghosts.shape
    errs = jnp.zeros(height, jnp.uint32)
    for clause in range(beliefs):
        errs = jnp.where(number == clause, ghosts[clause], errs)
    return errs
