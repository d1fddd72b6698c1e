"""What the samplers share: walled rooms, uniform placement, reachability, first states.

Levels are drawn on an unpadded plane uint8[width, height] of packed tiles, indexed [x, y]. All work
is of fixed size: a cell is chosen by its rank among the free ones, never by trying.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.rules import RuleState
from envs_jax.minigrid.state import PADDING, GridState
from envs_jax.minigrid.tasks import GoalState
from jaxact.compaction import for_each_chosen
from jaxact.pomdp import Episode


def walled(width: int, height: int) -> np.ndarray:
    """Returns an empty plane uint8[width, height] with walls round it."""
    plane = np.full((width, height), tiles.WALL_TILE, np.uint8)
    plane[1:-1, 1:-1] = tiles.EMPTY_TILE
    return plane


def uniform_int(draw: jax.Array, low: jax.Array | int, high: jax.Array | int) -> jax.Array:
    """Turns a uniform `draw` in [0, 1) into a uniform int32 in low … high − 1."""
    span = jnp.asarray(high, jnp.int32) - jnp.asarray(low, jnp.int32)
    # A float32 product can round up to `span` itself.
    rank = jnp.minimum((draw * span.astype(jnp.float32)).astype(jnp.int32), span - 1)
    return jnp.asarray(low, jnp.int32) + rank


def split_draw(draw: jax.Array, count: jax.Array | int) -> tuple[jax.Array, jax.Array]:
    """Turns a uniform `draw` in [0, 1) into a uniform int32 below `count` and another such draw.

    For small counts: what is left of the 23 random bits must do for the second draw.
    """
    scaled = draw * jnp.float32(count)
    value = jnp.minimum(scaled.astype(jnp.int32), count - 1)
    return value, scaled - value.astype(jnp.float32)


def choose_cell(draw: jax.Array, free: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Chooses a cell uniformly.

    Args:
      draw: uniform float32 in [0, 1), the only randomness.
      free: bool[width, height], the cells to choose from.

    Returns:
      int32[2] position, and a bool: false when there is no free cell (the position then means
      nothing).
    """
    columns = running_sums(jnp.sum(free, axis=1, dtype=jnp.int32))
    chosen = uniform_int(draw, 0, columns[-1])
    x = jnp.sum(columns <= chosen, dtype=jnp.int32)
    left = chosen - jnp.where(x > 0, columns[x - 1], 0)
    y = jnp.sum(running_sums(free[x].astype(jnp.int32)) <= left, dtype=jnp.int32)
    return jnp.stack([x, y]), columns[-1] > 0


def choose_ranked(rank: jax.Array, counts: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns in which of some short ranges a rank falls, int32, and its rank in there.

    Args:
      rank: int32 scalar, below the sum of `counts`.
      counts: int32[n], the ranges' sizes.
    """
    ends = running_sums(counts)
    before = ends <= rank
    return jnp.sum(before, dtype=jnp.int32), rank - jnp.max(jnp.where(before, ends, 0))


def ranked_cell(rank: jax.Array, rows: jax.Array, height: int) -> jax.Array:
    """Returns the cell, int32[2], of a rank among those packed by `packed_rows`.

    Args:
      rank: int32 scalar, below the number of cells.
      rows: uint32[width].
      height: how many bits of them can be set.
    """
    bits = rows[:, None] >> jnp.arange(height, dtype=jnp.uint32) & 1
    x, left = choose_ranked(rank, jnp.sum(bits.astype(jnp.int32), axis=1, dtype=jnp.int32))
    row = entry(rows, x)
    up_to = np.array([(2 << y) - 1 for y in range(height)], np.uint32)
    y = jnp.sum(bit_counts(row & up_to) <= left, dtype=jnp.int32)
    return jnp.stack([x, y])


def choose_packed(draw: jax.Array, rows: jax.Array, height: int) -> tuple[jax.Array, jax.Array]:
    """Does what `choose_cell` does, with cells packed by `packed_rows` into uint32[width]."""
    total = jnp.sum(bit_counts(rows), dtype=jnp.int32)
    return ranked_cell(uniform_int(draw, 0, total), rows, height), total > 0


def without(rows: jax.Array, cell: jax.Array) -> jax.Array:
    """Returns packed cells uint32[width] without the cell int32[2]."""
    here = jnp.arange(rows.shape[0], dtype=jnp.int32) == cell[0]
    return rows & ~jnp.where(here, jnp.uint32(1) << cell[1].astype(jnp.uint32), jnp.uint32(0))


def entry(values: jax.Array, index: jax.Array | int) -> jax.Array:
    """Returns values[index], of a few unsigned integers or arrays of them.

    Under `vmap` with an index for each lane it is much cheaper than a gather.
    """
    if isinstance(index, int):
        return values[index]
    places = jnp.arange(values.shape[0], dtype=jnp.int32).reshape(-1, *[1] * (values.ndim - 1))
    return jnp.max(jnp.where(places == index, values, jnp.zeros_like(values)), axis=0)


def bit_counts(words: jax.Array) -> jax.Array:
    """Returns how many bits of each uint32 are set, int32."""
    return jax.lax.population_count(words).astype(jnp.int32)


def running_sums(counts: jax.Array) -> jax.Array:
    """Returns the running sums of a short int32[n]; n² additions beat n dependent ones here."""
    earlier = np.tri(counts.shape[0], dtype=bool)
    return jnp.sum(jnp.where(earlier, counts[None, :], 0), axis=1, dtype=jnp.int32)


def ranks(values: jax.Array) -> jax.Array:
    """Returns each entry's place, int32, in the sorted order of a short float32[n], ties in theirs.

    n² comparisons, because XLA sorts small arrays slowly.
    """
    places = np.arange(values.shape[0])
    equal_before = (values[None, :] == values[:, None]) & (places[None, :] < places[:, None])
    before = (values[None, :] < values[:, None]) | equal_before
    return jnp.sum(before, axis=1, dtype=jnp.int32)


def order(values: jax.Array) -> jax.Array:
    """Returns what `jnp.argsort` does, int32, of a short float32[n]; see `ranks`."""
    places = jnp.arange(values.shape[0], dtype=jnp.int32)
    is_there = ranks(values)[None, :] == places[:, None]
    return jnp.sum(jnp.where(is_there, places, 0), axis=1, dtype=jnp.int32)


def at(position: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Returns bool[width, height], true at `position` alone."""
    x = jnp.arange(shape[0], dtype=jnp.int32)[:, None] == position[0]
    return x & (jnp.arange(shape[1], dtype=jnp.int32)[None, :] == position[1])


def put(plane: jax.Array, position: jax.Array, code: jax.Array | int) -> jax.Array:
    """Returns `plane` with the packed tile `code` at `position`."""
    return jnp.where(at(position, plane.shape), jnp.asarray(code, plane.dtype), plane)


def objects_reachable(plane: jax.Array, position: jax.Array) -> jax.Array:
    """Returns a bool: the agent can get next to everything without moving anything.

    Doors count as open, whatever their state; walls need not be reached.

    Source: `RoomGridLevel.check_objs_reachable` of minigrid 3.2.0.
    """
    kinds = plane & tiles.TYPE_MASK
    door = (kinds == tiles.OPEN_DOOR) | (
        (kinds >= tiles.CLOSED_DOOR) & (kinds <= tiles.OPEN_LOCKED_DOOR)
    )
    open_rows = packed_rows((kinds == tiles.EMPTY) | door)
    objects = packed_rows((kinds != tiles.EMPTY) & (kinds != tiles.WALL))
    start = packed_rows(at(position, plane.shape))

    def grow(rows: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        return rows[1], rows[1] | spread(rows[1]) & open_rows

    reached, _ = jax.lax.while_loop(
        lambda rows: jnp.any(rows[0] != rows[1]), grow, (jnp.zeros_like(start), start)
    )
    return jnp.all(objects & ~spread(reached) == 0)


def largest_component(free: jax.Array) -> jax.Array:
    """Returns the largest of the 4-connected parts of `free`, the first found if several are.

    Args:
      free: bool[width, height], height at most 32.

    Returns:
      bool[width, height]; all false when `free` is.
    """

    def count(rows: jax.Array) -> jax.Array:
        return jnp.sum(jax.lax.population_count(rows), dtype=jnp.uint32)

    def first_cell(rows: jax.Array) -> jax.Array:
        lowest = rows & -rows
        first = jnp.arange(rows.shape[0], dtype=jnp.int32) == jnp.argmax(rows != 0)
        return jnp.where(first, lowest, jnp.uint32(0))

    # One loop both grows the present part and goes on to the next: under `vmap`, lanes wait for the
    # one with most to do, not for the longest part of each.
    def grow(
        parts: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        part, left, largest = parts
        grown = part | spread(part) & left
        whole = jnp.all(grown == part)
        larger = whole & (count(part) > count(largest))
        left = jnp.where(whole, left & ~part, left)
        return (
            jnp.where(whole, first_cell(left), grown),
            left,
            jnp.where(larger, part, largest),
        )

    rows = packed_rows(free)
    _, _, largest = jax.lax.while_loop(
        lambda parts: count(parts[1]) > count(parts[2]),
        grow,
        (first_cell(rows), rows, jnp.zeros_like(rows)),
    )
    bits = jnp.arange(free.shape[1], dtype=jnp.uint32)
    return (largest[:, None] >> bits[None, :]) & 1 == 1


def spread(rows: jax.Array) -> jax.Array:
    """Returns the cells packed by `packed_rows`, and those beside them."""
    edge = jnp.zeros((1,), rows.dtype)
    beside = jnp.concatenate([rows[1:], edge]) | jnp.concatenate([edge, rows[:-1]])
    return rows | rows << 1 | rows >> 1 | beside


def packed_rows(cells: jax.Array) -> jax.Array:
    """Packs bool[..., height] into uint32[...], bit y for cell y (height ≤ 32)."""
    bits = np.uint32(1) << np.arange(cells.shape[-1], dtype=np.uint32)
    return jnp.sum(jnp.where(cells, bits, jnp.uint32(0)), axis=-1, dtype=jnp.uint32)


def until_valid(
    key: jax.Array, count: int, draw: Callable[[jax.Array], tuple[Any, jax.Array]]
) -> Any:
    """Draws whole levels until one is valid, as MiniGrid's rejection sampling does.

    In a batch only the levels that were not valid are drawn again.

    Args:
      key: a PRNG key.
      count: how many draws a level takes.
      draw: turns uniform float32[count] in [0, 1), the only randomness, into a level (any pytree)
        and a bool, whether it is valid. It must not depend on other traced values.
    """

    def draws_of(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        next_key, draw_key = jax.random.split(key)
        return next_key, jax.random.uniform(draw_key, (count,), jnp.float32)

    # Loops carry the draws of the next attempt: what is carried is computed once. XLA would repeat
    # the hash in every kernel that uses some of the draws, which takes long to compile.
    @jax.jit  # So that it is traced once.
    def attempt(
        chance: tuple[jax.Array, jax.Array],
    ) -> tuple[tuple[jax.Array, jax.Array], Any, jax.Array]:
        next_key, draws = chance
        return draws_of(next_key), *draw(draws)

    @jax.custom_batching.custom_vmap
    def first_valid(key: jax.Array) -> Any:
        chance = draws_of(key)
        _, level, _ = jax.lax.while_loop(
            lambda tried: ~tried[2],
            lambda tried: attempt(tried[0]),
            (chance, *jax.tree.map(jnp.zeros_like, jax.eval_shape(attempt, chance)[1:])),
        )
        return level

    @first_valid.def_vmap
    def first_valid_of_each(size: int, batched: list[bool], keys: jax.Array) -> tuple[Any, Any]:
        del batched  # There is no other argument that could be the batched one.

        def try_some(
            places: jax.Array, rows: jax.Array, found: tuple[Any, Any]
        ) -> tuple[jax.Array, tuple[Any, Any]]:
            chances = jax.tree.map(lambda leaf: leaf[rows], found[0])
            new_chances, new_levels, valid = jax.vmap(attempt)(chances)
            found = jax.tree.map(
                lambda x, y: x.at[places].set(y, mode="drop"), found, (new_chances, new_levels)
            )
            return ~valid, found

        chances = jax.vmap(draws_of)(keys)
        shapes = jax.eval_shape(jax.vmap(attempt), chances)[1]
        nothing = jax.tree.map(jnp.zeros_like, shapes)
        everyone = jnp.ones(size, bool)
        _, levels = for_each_chosen(everyone, (chances, nothing), try_some, share=16)
        return levels, jax.tree.map(lambda _: True, levels)

    return first_valid(key)


def grid_state(
    plane: jax.Array,
    position: jax.Array,
    direction: jax.Array,
    marks: jax.Array | None = None,
) -> GridState:
    """Returns the first state of a level, the agent's hands empty.

    Args:
      plane: uint8[width, height] of packed tiles.
      position: int32[2].
      direction: int32 scalar.
      marks: uint16[width, height], see `GridState.marks`; none when left out.
    """
    if marks is None:
        marks = jnp.zeros(plane.shape, jnp.uint16)
    return GridState(
        tiles=jnp.pad(plane, PADDING, constant_values=tiles.WALL_TILE),
        marks=jnp.pad(marks, PADDING),
        position=position,
        direction=direction,
        carrying=jnp.uint8(0),
        carrying_mark=jnp.uint16(0),
    )


def goal_episode(state: GridState, mission: np.ndarray | jax.Array, max_steps: int) -> Episode:
    """Returns the episode of a `GoalTask` that begins in `state`."""
    horizon = jnp.int32(max_steps)
    return Episode(state, GoalState(jnp.int32(0), horizon, jnp.asarray(mission)), horizon)


def rule_episode(
    state: GridState,
    rule: int,
    mission: np.ndarray | jax.Array,
    max_steps: int,
    *,
    target: jax.Array | int = 0,
    cells: Sequence[jax.Array] = (),
) -> Episode:
    """Returns the episode of a `RuleTask` that begins in `state`, its doors shut.

    Args:
      state: the world.
      rule: see `rules`.
      mission: int32[MISSION_LENGTH] tokens.
      max_steps: the horizon.
      target: packed tile of what the rule is about, if anything.
      cells: up to two cells int32[2] that the rule is about.
    """
    horizon = jnp.int32(max_steps)
    nowhere = [jnp.zeros(2, jnp.int32)] * (2 - len(cells))
    task = RuleState(
        steps=jnp.int32(0),
        max_steps=horizon,
        mission=jnp.asarray(mission),
        rule=jnp.int32(rule),
        target=jnp.asarray(target, jnp.uint8),
        cells=jnp.stack([*cells, *nowhere]),
        opened=jnp.zeros(2, bool),
    )
    return Episode(state, task, horizon)
