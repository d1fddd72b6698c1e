"""BabyAI's instructions as data: what there is to do, in which order, and what counts as done.

An instruction has up to four clauses, such as "go to the red ball" or "put a key next to the box",
numbered in the order in which the mission names them. A set of clauses is four bits, so a whole
instruction is one word, its `Program`, and one step of all clauses is a few operations on bits.

A clause speaks of at most two descriptions of objects. Identities travel with the objects, in the
low byte of their marks: bit i says that the object is one of those that clause i wants the agent to
go to, or to put something next to (its *places*); bit 4 + i that it is one of those that clause i
wants opened, picked up or put somewhere (its *things*).

Source: `verifier` and `RoomGridLevel.step` of minigrid 3.2.0.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from envs_jax.minigrid.environment import (
    DOORS,
    DROP,
    OPEN_DOORS,
    PICKUP,
    TOGGLE,
    at_index,
    cell_index,
    front_index,
    heading,
    is_kind,
)
from envs_jax.minigrid.state import GridState

MAX_CLAUSES = 4
_ALL = (1 << MAX_CLAUSES) - 1

# What a clause demands. A sampler leaves out clauses with `NOTHING`.
NOTHING, GO_TO, OPEN, PICK_UP, PUT_NEXT = range(5)
# How a clause is joined to the one named before it; `ALONE` where that or this one is left out.
ALONE, AND, THEN, AFTER = range(4)

# The packed program of a single clause, "go to".
ONE_GO_TO = 1


class Program(NamedTuple):
    """What does not change while an instruction is followed: sets of clauses, uint32 each.

    Attributes:
      go_to: clauses done by facing a place, whatever the action.
      open: clauses done by the toggle that opens a thing.
      pick_up: clauses done by picking up a thing with empty hands.
      put_next: clauses done by dropping a thing right beside a place.
      strict: clauses that fail when another door is toggled, or another object picked up.
      later: clauses that count only when all others are done, from that very step on.
    """

    go_to: jax.Array
    open: jax.Array
    pick_up: jax.Array
    put_next: jax.Array
    strict: jax.Array
    later: jax.Array

    def pack(self) -> jax.Array:
        """Returns the program as one uint32, four bits a set."""
        word = jnp.uint32(0)
        for place, clauses in enumerate(self):
            word |= clauses.astype(jnp.uint32) << (MAX_CLAUSES * place)
        return word

    @classmethod
    def unpack(cls, word: jax.Array) -> Program:
        """Returns the program that `pack` made the uint32 `word` of."""
        return cls(*(word >> (MAX_CLAUSES * place) & _ALL for place in range(len(cls._fields))))


class Progress(NamedTuple):
    """How far an instruction has been followed: sets of clauses, uint32 each.

    Attributes:
      done: clauses that are done for good.
      begun: clauses that were looked at before: only these know what the agent held.
    """

    done: jax.Array
    begun: jax.Array

    def pack(self) -> jax.Array:
        """Returns the progress as one uint8."""
        return (self.done | self.begun << MAX_CLAUSES).astype(jnp.uint8)

    @classmethod
    def unpack(cls, byte: jax.Array) -> Progress:
        """Returns the progress that `pack` made the uint8 `byte` of."""
        word = byte.astype(jnp.uint32)
        return cls(word & _ALL, word >> MAX_CLAUSES)


def verify(
    program: Program,
    progress: Progress,
    ghosts: jax.Array,
    before: GridState,
    action: jax.Array,
    after: GridState,
) -> tuple[Progress, jax.Array, jax.Array]:
    """Judges one step of an instruction.

    Args:
      program: the instruction.
      progress: how far it was followed.
      ghosts: uint32[beliefs, height] after the step; see `believe`.
      before: the world before the step.
      action: int32 scalar.
      after: the world after the step.

    Returns:
      The progress, and two bools: whether the instruction is fulfilled, and whether it has failed.
    """
    hits, misses = _judge(program, progress.begun, ghosts, before, action, after)
    clauses = program.go_to | program.open | program.pick_up | program.put_next
    # With nothing that comes later, what there is to do is the second stage.
    first = jnp.where(program.later == 0, jnp.uint32(0), clauses & ~program.later)
    last = clauses & ~first

    looked_at = first & ~progress.done
    done = progress.done | (hits & looked_at)
    failed = _is_single(first) & (misses & looked_at != 0)
    on = first & ~done == 0
    looked_at |= jnp.where(on, last & ~done, jnp.uint32(0))
    ending = done | (hits & looked_at)
    success = on & (last & ~ending == 0)
    failed |= _is_single(last) & (misses & looked_at & last != 0)
    # The last clause, standing alone, is looked at afresh even once it was done.
    done = jnp.where(_is_single(last), done, ending)
    return Progress(done, progress.begun | looked_at), success, failed


def _is_single(clauses: jax.Array) -> jax.Array:
    return clauses & (clauses - 1) == 0


def _judge(
    program: Program,
    begun: jax.Array,
    ghosts: jax.Array,
    before: GridState,
    action: jax.Array,
    after: GridState,
) -> tuple[jax.Array, jax.Array]:
    """Returns two sets of clauses: those the step would complete, those it would make fail."""
    height = ghosts.shape[1]
    front = front_index(after, height)
    faced = at_index(after.marks, front).astype(jnp.uint32)
    door, nothing = at_index(after.tiles, front), jnp.uint32(0)
    picks, drops, toggles = action == PICKUP, action == DROP, action == TOGGLE
    had, has = (_things(state.carrying_mark) for state in (before, after))

    hits = program.go_to & (faced ^ _ghosts_at_front(ghosts, after))
    opens = toggles & is_kind(door, OPEN_DOORS)
    hits |= program.open & jnp.where(opens, _things(faced), nothing)
    took = jnp.where(before.carrying == 0, has, has & ~begun)
    hits |= program.pick_up & jnp.where(picks, took, nothing)
    dropped = drops & (after.carrying == 0)
    beside = _beside(after, height) & had & begun
    hits |= program.put_next & jnp.where(dropped, beside, nothing)

    misses = program.open & jnp.where(toggles & is_kind(door, DOORS), program.strict, nothing)
    holding = picks & (after.carrying != 0)
    handled = program.pick_up | program.put_next
    misses |= handled & jnp.where(holding, program.strict, nothing)
    return hits, misses & ~hits


def _things(mark: jax.Array) -> jax.Array:
    """Returns the uint32 set of clauses of whose things the object with this mark is one."""
    return mark.astype(jnp.uint32) >> MAX_CLAUSES & _ALL


def _beside(state: GridState, height: int) -> jax.Array:
    """Returns the set of clauses that have a place beside the cell that the agent faces."""
    front = state.position + heading(state.direction)
    marks = jnp.uint32(0)
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        cell = cell_index(front + jnp.array([x, y], jnp.int32), height)
        marks |= at_index(state.marks, cell).astype(jnp.uint32)
    return marks & _ALL


def believe(ghosts: jax.Array, before: GridState, action: jax.Array, after: GridState) -> jax.Array:
    """Returns where clauses err about their places after a step.

    Where its places are, a clause looks up anew only when the agent drops something, or tries to.
    Until then a place that was carried off, or destroyed, is still believed where it was.

    Args:
      ghosts: uint32[beliefs, height] before the step, bit x of row y: clause i errs about cell
        (x, y). `beliefs` is how many of the first clauses can be of the kind "go to"; no other kind
        acts on a belief that is not fresh.
      before: the world before the step.
      action: int32 scalar.
      after: the world after the step.
    """
    beliefs, height = ghosts.shape
    if beliefs == 0:
        return ghosts
    cell = front_index(before, height)
    changed = (at_index(before.marks, cell) ^ at_index(after.marks, cell)).astype(jnp.uint32)
    clauses = jnp.arange(beliefs, dtype=jnp.uint32)
    left = (changed >> clauses & 1 == 1)[:, None]
    ghosts = jnp.where(left, ghosts ^ _front_bit(before, height), ghosts)
    return jnp.where(action == DROP, jnp.uint32(0), ghosts)


def _front_bit(state: GridState, height: int) -> jax.Array:
    """Returns uint32[1, height] with one bit set, that of the cell the agent faces."""
    x, y = state.position + heading(state.direction)
    rows = jnp.arange(height, dtype=jnp.int32) == y
    return jnp.where(rows, jnp.uint32(1) << x.astype(jnp.uint32), jnp.uint32(0))[None]


def _ghosts_at_front(ghosts: jax.Array, state: GridState) -> jax.Array:
    """Returns the set of clauses that err about the cell that the agent faces."""
    beliefs, height = ghosts.shape
    errs = jnp.any(ghosts & _front_bit(state, height) != 0, axis=1)
    bits = jnp.uint32(1) << jnp.arange(beliefs, dtype=jnp.uint32)
    return jnp.sum(jnp.where(errs, bits, jnp.uint32(0)), dtype=jnp.uint32)
