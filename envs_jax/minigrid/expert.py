"""The experts of grid-world tasks: what to do next, from the state alone.

An expert here keeps no memory. Every step it plans anew, with `planner`, so it can advise an agent
from wherever that agent has got to; it knows the whole grid, seen or not. Its advice is the first
action of a shortest plan, counted in actions, with one exception: a plan that passes the same
closed door twice counts its opening twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.minigrid import planner, tiles
from envs_jax.minigrid.environment import (
    DONE,
    DROP,
    FORWARD,
    LEFT,
    PICKUP,
    PORTABLE,
    RIGHT,
    TOGGLE,
    at_index,
    front_index,
    is_kind,
)
from envs_jax.minigrid.guide import Guide, make_guide
from envs_jax.minigrid.planner import Board, Plan, Terrain
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.pomdp import ExpertAction

_WALKABLE = 1 << tiles.EMPTY | 1 << tiles.FLOOR | 1 << tiles.OPEN_DOOR | 1 << tiles.OPEN_LOCKED_DOOR


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Map:
    """Bitboards word[H] (see `planner`) of the cells that matter to a plan.

    Attributes:
      walkable: cells to step on, neither goal nor lava.
      closed: doors to be opened without a key.
      loose: objects that can be carried off.
      keys: keys of `color`.
      locks: locked doors of `color`.
      color: uint8 scalar, the colour (in a tile's high bits) of the locks that can be dealt with.
    """

    walkable: Board
    closed: Board
    loose: Board
    keys: Board
    locks: Board
    color: jax.Array


def goal_expert(
    key: jax.Array, task_state: Any, state: GridState, width: int, height: int
) -> ExpertAction:
    """Advises the first action of a shortest plan to step onto a goal square.

    The plan keeps off lava, opens closed doors, and, where that leads to the goal or is shorter,
    takes up a key, unlocks the doors of its colour and passes. It is optimal over the whole
    sequence: for example, the key is approached from the side from which key, door and goal
    together are nearest. Locks of one colour are dealt with; nothing but that key is ever carried.

    Args:
      key: unused, the expert is deterministic.
      task_state: unused.
      state: the world.
      width: cells of the grid along x, at most 32.
      height: cells of the grid along y.

    Returns:
      An int32 action of `GridWorld`. It is not valid where there is no such plan.
    """
    del key, task_state
    cells = _cells(state.tiles)
    terrain, layer = _layers(_survey(cells, state.carrying, spare_keys=True), state.carrying)
    plan = planner.plan(terrain, _goals(cells), state.position, state.direction, layer)
    # The plan ends in front of the goal.
    return ExpertAction(_name(plan, state, height, FORWARD), plan.reached)


def goal_guide(state: GridState, near: int) -> Guide:
    """Returns the plans of `goal_expert` for all poses, as long as nothing is moved or opened.

    They end in front of a goal square; see `guide.make_guide` for `near`.
    """
    cells = _cells(state.tiles)
    walkable = planner.pack(is_kind(cells, _WALKABLE))
    return make_guide(walkable, _goals(cells), near)


def goto_expert(
    key: jax.Array, task_state: Any, state: GridState, width: int, height: int
) -> ExpertAction:
    """Advises the first action of a shortest plan to face an object of the instruction.

    What is looked for are the cells in which the instruction believes its objects to be, stale
    beliefs included. Facing one already, the advice is `done`. Doors and locks are dealt with as by
    `goal_expert`; the plan keeps off goal squares and lava.

    Where objects are in the way of every plan, they are carried off one by one: the plan with the
    fewest actions is chosen that treats an object in the way like a closed door. An agent that has
    its hands full by then first drops what it holds into the next empty cell that is not its way.
    This solves the task, but is not always the shortest solution.

    Args:
      key: unused, the expert is deterministic.
      task_state: the instruction's progress; of it, `ghosts` uint32[beliefs, H] is read: cells
        (bit x of row y) where belief and world disagree.
      state: the world.
      width: cells of the grid along x, at most 32.
      height: cells of the grid along y.

    Returns:
      An int32 action of `GridWorld`. It is not valid where no object can be reached.
    """
    del key
    cells = _cells(state.tiles)
    tracked = planner.pack(_cells(state.marks) & jnp.uint16(1) != 0)
    targets = tracked ^ task_state.ghosts[0].astype(tracked.dtype)
    survey = _survey(cells, state.carrying, spare_keys=False)
    terrain, layer = _layers(survey, state.carrying)
    plan = planner.plan(terrain, targets, state.position, state.direction, layer)

    cleared = _with_loose_objects_slow(survey, state.carrying)
    detour = planner.plan(
        cleared, targets, state.position, state.direction, layer, active=~plan.reached
    )
    hands_full = state.carrying != 0
    holds_target = state.carrying_mark & jnp.uint16(1) != 0
    action = jnp.where(
        plan.reached,
        _name(plan, state, height, DONE),
        jnp.where(
            hands_full, _empty_hands(detour, state, height), _name(detour, state, height, DONE)
        ),
    )
    return ExpertAction(action, plan.reached | detour.reached | holds_target)


def _cells(plane: jax.Array) -> jax.Array:
    """Cuts the grid [W, H] out of a padded plane."""
    return plane[PADDING:-PADDING, PADDING:-PADDING]


def _goals(cells: jax.Array) -> Board:
    return planner.pack(cells & tiles.TYPE_MASK == tiles.GOAL)


def _survey(cells: jax.Array, carrying: jax.Array, spare_keys: bool) -> _Map:
    """Maps tiles uint8[W, H]. The locks to deal with are those that the key in hand fits; without
    such a key, those of the first locked door's colour.

    With nothing (left) to unlock, all keys count if `spare_keys`: they may stand in the way.
    """
    kinds, colors = cells & tiles.TYPE_MASK, cells & (255 - tiles.TYPE_MASK)
    is_locked = kinds == tiles.LOCKED_DOOR
    first = colors.reshape(-1)[jnp.argmax(is_locked.reshape(-1))]
    held = carrying & (255 - tiles.TYPE_MASK)
    holds_key = carrying & tiles.TYPE_MASK == tiles.KEY
    fits = holds_key & jnp.any(is_locked & (colors == held))
    color = jnp.where(fits, held, first)
    wanted = jnp.where(jnp.any(is_locked), colors == color, spare_keys)
    return _Map(
        walkable=planner.pack(is_kind(cells, _WALKABLE)),
        closed=planner.pack(kinds == tiles.CLOSED_DOOR),
        loose=planner.pack(is_kind(cells, PORTABLE)),
        keys=planner.pack((kinds == tiles.KEY) & wanted),
        locks=planner.pack(is_locked & (colors == color)),
        color=color,
    )


def _layers(survey: _Map, carrying: jax.Array) -> tuple[Terrain, jax.Array]:
    """Returns the layers without key, with key in hand, and unlocked; and the one we are in.

    In the last two the key has left its cell. If there are several keys, it is not known which one
    was taken, and all stay in the way.
    """
    nothing = jnp.zeros_like(survey.keys)
    empty_handed = carrying == 0
    count = jnp.sum(jax.lax.population_count(survey.keys), dtype=jnp.uint32)
    vacated = jnp.where(empty_handed & (count == 1), survey.keys, nothing)
    with_key = survey.walkable | vacated
    terrain = Terrain(
        open=jnp.stack([survey.walkable, with_key, with_key | survey.locks]),
        slow=jnp.stack([survey.closed] * 3),
        gates=jnp.stack([jnp.where(empty_handed, survey.keys, nothing), survey.locks]),
    )
    return terrain, (carrying == survey.color | tiles.KEY).astype(jnp.int32)


def _with_loose_objects_slow(survey: _Map, carrying: jax.Array) -> Terrain:
    """Returns the layers in which objects are like closed doors, as if hands could hold many."""
    terrain, _ = _layers(survey, jnp.where(_has_key(survey, carrying), carrying, jnp.uint8(0)))
    taken = terrain.open.at[: len(terrain.gates)].set(terrain.open[:-1] | terrain.gates)
    return replace(terrain, slow=terrain.slow | (survey.loose & ~taken))


def _has_key(survey: _Map, carrying: jax.Array) -> jax.Array:
    return carrying == survey.color | tiles.KEY


def _name(plan: Plan, state: GridState, height: int, arrival: int) -> jax.Array:
    """Turns a plan's action into the environment's; `arrival` is what to do at a goal pose."""
    ahead = at_index(state.tiles, front_index(state, height))
    act = jnp.where(is_kind(ahead, PORTABLE), PICKUP, TOGGLE)
    choices = jnp.stack([jnp.full_like(act, value) for value in (LEFT, RIGHT, FORWARD)])
    choices = jnp.concatenate([choices, act[None], jnp.full_like(act, arrival)[None]])
    return choices[plan.action].astype(jnp.int32)


def _empty_hands(detour: Plan, state: GridState, height: int) -> jax.Array:
    """Returns what to do with full hands where objects are in the way of every plan.

    It walks on while it can, and drops what it holds where that is not into its way. No memory is
    needed: a dropped object is off the way, so that the next plan need not take it up again.
    """
    walks = detour.reached & (detour.action == planner.FORWARD)
    is_free = at_index(state.tiles, front_index(state, height)) & tiles.TYPE_MASK == tiles.EMPTY
    action = jnp.where(walks, FORWARD, jnp.where(is_free, DROP, RIGHT))
    return action.astype(jnp.int32)
