"""Experts that walk and look as the agent can: in its steps and turns, into nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import clearance, obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import GoalField, distance, nearby, ways
from envs_jax.houses.journey import Journey
from envs_jax.houses.scene import forward
from envs_jax.houses.state import HouseState
from envs_jax.houses.visibility import Sight, camera, in_frustum, seen_points
from jaxact.compaction import while_loop_for_few

# Metres that each turn counts for, to choose between headings that are as good.
_TURN_COST = 1e-3
# Of the nodes of the way it plans with so many that it sees, and so many that it does not within
# some metres.
_SEEN, _HIDDEN, _NEAR = 8, 4, 1.5
# A step or walk that leads no nearer than this, in metres, ends in a corner: if no walk leads out
# of it, any step is preferred at random, by up to so much.
_GAIN, _LUCK = 0.02, 0.4
# Up to so many metres further from a goal than it has been, it may be on its way out of a corner.
_DETOUR = 1.5
# Metres from a goal that a step can miss at which it begins to search.
_CAREFUL = 2.0
# A search is over once a walk leads nearer by so many metres.
_PROGRESS = 0.1
# A search goes on from so many places at a time, one in each square of so many metres, for so many
# steps, among so many boxes, the nearest.
_PLACES, _SQUARE, _DEPTH, _BOXES = 12, 0.03, 8, 16


def walk(house: House, journey: Journey, state: HouseState, arrived: jax.Array) -> jax.Array:
    """Returns the next action of a short way to the nearest goal.

    Of all headings that turns lead to, it takes the one in which a step ahead leaves the shortest
    way. Where no step leads nearer, and close to goals that a step can miss, it searches for the
    shortest walk to a place that is nearer than it has been, or near enough. If there is none, it
    takes a step at random.

    Args:
      house: the dynamics; noise is left out of account.
      journey: so far.
      state: of the agent.
      arrived: float32 scalar, metres from a goal within which nothing is gained by going nearer; 0
        if goals only show the way.

    Returns:
      An int32 scalar, one of `house.actions`.
    """
    boxes, radius = obstacles(state.scene.boxes, house.body), house.body.radius
    field, now = nearby(journey.field, boxes, radius, state.position, _SEEN, _HIDDEN, _NEAR)
    turns = _turns(house)

    def ahead(turn: jax.Array) -> jax.Array:
        way = forward(state.yaw + turn.astype(jnp.float32) * jnp.float32(house.turn))
        place, _ = house.move(boxes, state.position, jnp.float32(house.step_size) * way)
        left, _ = distance(field, boxes, radius, place)
        stays = jnp.sum((place - state.position) ** 2) < 1e-6
        return jnp.where(stays, jnp.inf, left)

    left = jax.vmap(ahead)(turns)
    # A draw belongs to a heading, so that turning does not change it.
    heading = jnp.round(state.yaw / jnp.float32(house.turn)).astype(jnp.int32)
    bits = jax.lax.bitcast_convert_type(journey.walked, jnp.uint32)
    draw = jax.random.fold_in(jax.random.key(0), bits)
    luck = _LUCK * jax.random.uniform(draw, turns.shape, jnp.float32)
    stuck = jnp.min(left) > now - _GAIN
    left += jnp.where(stuck, luck[(heading + turns) % turns.shape[0]], 0)
    turn = turns[jnp.argmin(left + _TURN_COST * jnp.abs(turns).astype(jnp.float32))]
    close = (arrived > 0) & (2 * arrived < house.step_size) & (now < _CAREFUL)
    least = jnp.minimum(now, journey.nearest)
    enough = jnp.where(close, arrived, jnp.maximum(least - _PROGRESS, arrived))
    useful = jnp.where(close, arrived, jnp.maximum(least - _GAIN, arrived))
    # Who leaves a corner must not go back to it; who has only strayed need not search.
    detour = now - journey.nearest
    strayed = (detour > _GAIN) & (detour < _DETOUR) & ~stuck & (now > arrived)

    def look_back(_: Any, known: Any) -> Any:
        return ~_leads_on(house, *known), jnp.bool_(False)

    here = field, boxes, state.position, state.yaw
    cornered = while_loop_for_few(
        lambda carry, _: carry[1], look_back, (strayed, strayed), (*here, now, useful)
    )[0]
    searches = stuck | cornered

    def look_ahead(carry: Any, known: Any) -> Any:
        *known, useful = known
        left, there = _search(house, *known)
        return jnp.where(left <= useful, there, carry[0]), jnp.bool_(False)

    known = (*here, enough, useful)
    carry = turn, (searches | close) & (now > arrived)
    turn, _ = while_loop_for_few(lambda carry, _: carry[1], look_ahead, carry, known)
    names = ("rotate_left", "move_ahead", "rotate_right")
    return jnp.array([house.actions.index(name) for name in names], jnp.int32)[jnp.sign(turn) + 1]


def _leads_on(
    house: House,
    field: GoalField,
    boxes: jax.Array,
    position: jax.Array,
    yaw: jax.Array,
    now: jax.Array,
    useful: jax.Array,
) -> jax.Array:
    """Returns a bool scalar: whether few steps, each to where least is left, lead near enough.

    That is far less work than to search.

    Args:
      house: the dynamics.
      field: of a few nodes, see `geodesic.nearby`.
      boxes: float32 [N, 8], obstacles.
      position: float32 [2], where to set out.
      yaw: float32 scalar, degrees.
      now: float32 scalar, metres that are left there.
      useful: float32 scalar, metres that may be left.
    """
    boxes, moves = _around(boxes, position), _moves(house, yaw)

    def go_on(
        carry: tuple[jax.Array, jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        depth, place, left, _ = carry
        after, _, lefts = jax.vmap(lambda move: _step(house, field, boxes, place, move))(moves)
        row = jnp.argmin(lefts)
        return depth + 1, after[row], lefts[row], lefts[row] > left - _GAIN

    def goes_on(carry: tuple[jax.Array, jax.Array, jax.Array, jax.Array]) -> jax.Array:
        depth, _, left, stuck = carry
        return (depth < _DEPTH) & (left > useful) & ~stuck

    begin = jnp.int32(0), position, now, jnp.bool_(False)
    return jax.lax.while_loop(goes_on, go_on, begin)[2] <= useful


def _search(
    house: House,
    field: GoalField,
    boxes: jax.Array,
    position: jax.Array,
    yaw: jax.Array,
    enough: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Searches for the shortest walk of few steps that leads near enough to a goal.

    Walks may touch things where the body stops or slides at them: who slides walks less far than a
    step, which is how walks come to be of lengths between.

    Args:
      house: the dynamics.
      field: of a few nodes, see `geodesic.nearby`.
      boxes: float32 [N, 8], obstacles.
      position: float32 [2], where to set out.
      yaw: float32 scalar, degrees.
      enough: float32 scalar, metres that may be left.

    Returns:
      The float32 metres that are left at the end of the walk, those of the best if none leads near
      enough, and the int32 turns to the right that it begins with.
    """
    boxes = _around(boxes, position)
    turns, moves = _turns(house), _moves(house, yaw)

    def go_on(carry: _Frontier) -> _Frontier:
        after, moved, left = jax.vmap(
            lambda place: jax.vmap(lambda move: _step(house, field, boxes, place, move))(moves)
        )(carry.places)
        after, left = after.reshape(-1, 2), left.reshape(-1)
        walked = (carry.walked[:, None] + moved).reshape(-1)
        firsts = jnp.where(carry.depth == 0, turns, carry.firsts[:, None]).reshape(-1)
        effort = walked + _TURN_COST * jnp.abs(firsts).astype(jnp.float32)
        there = jnp.where(left <= enough, effort, jnp.inf)
        row = jnp.argmin(there)
        arrives = there[row] < carry.cost
        nearest = jnp.argmin(left)
        nearer = left[nearest] < carry.left
        strays = nearer & (carry.cost == jnp.inf)
        cost = jnp.where(left <= enough, jnp.inf, effort + left)
        # The same place is come to in many ways: the best of each square is kept.
        squares = jnp.round((after - position) / _SQUARE).astype(jnp.int32)
        square = squares[:, 0] * 4096 + squares[:, 1]
        numbers = jnp.arange(square.shape[0], dtype=jnp.int32)
        square, cost, order = jax.lax.sort((square, cost, numbers), num_keys=2)
        again = jnp.concatenate([jnp.zeros(1, bool), square[1:] == square[:-1]])
        cost, kept = jax.lax.top_k(-jnp.where(again, jnp.inf, cost), _PLACES)
        rows = order[kept]
        none = cost == -jnp.inf
        return _Frontier(
            carry.depth + 1,
            after[rows],
            jnp.where(none, jnp.inf, walked[rows]),
            firsts[rows],
            -cost[0],
            jnp.where(arrives, there[row], carry.cost),
            jnp.where(nearer, left[nearest], carry.left),
            jnp.where(arrives, firsts[row], jnp.where(strays, firsts[nearest], carry.first)),
        )

    begin = _Frontier(
        jnp.int32(0),
        jnp.broadcast_to(position, (_PLACES, 2)),
        jnp.zeros(_PLACES, jnp.float32),
        jnp.zeros(_PLACES, jnp.int32),
        jnp.float32(0),
        jnp.float32(jnp.inf),
        jnp.float32(jnp.inf),
        jnp.int32(0),
    )
    end = jax.lax.while_loop(
        lambda carry: (carry.depth < _DEPTH) & (carry.cost > carry.bound - enough), go_on, begin
    )
    return end.left, end.first


def _around(boxes: jax.Array, position: jax.Array) -> jax.Array:
    """Returns the obstacles of [N, 8] that a search from a plan reckons with, the nearest."""
    away, _ = clearance(boxes, position)
    return boxes[jax.lax.top_k(-away, min(_BOXES, boxes.shape[0]))[1]]


def _moves(house: House, yaw: jax.Array) -> jax.Array:
    """Returns a step ahead, float32 [T, 2], in each heading that turns (see `_turns`) lead to."""
    angles = yaw + _turns(house).astype(jnp.float32) * jnp.float32(house.turn)
    return jnp.float32(house.step_size) * forward(angles)


def _step(
    house: House, field: GoalField, boxes: jax.Array, place: jax.Array, move: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Takes a step from a plan [2].

    Returns:
      Where it leads [2], how far that is, and the metres left there, infinite if it is nowhere.
    """
    radius = house.body.radius
    after, _ = house.move(boxes, place, move)
    moved = jnp.sqrt(jnp.sum((after - place) ** 2))
    left = jnp.min(ways(boxes, radius, after, field.nodes) + field.lengths)
    return after, moved, jnp.where(moved < 1e-3, jnp.inf, left)


class _Frontier(NamedTuple):
    """Where a search has got to.

    Attributes:
      depth: int32 scalar, in how many steps.
      places: float32 [P, 2], to where.
      walked: float32 [P], metres of the walks there; infinite where there are fewer.
      firsts: int32 [P], turns that the walks there begin with.
      bound: float32 scalar, the least metres of any walk by way of a place, with what is left.
      cost: float32 scalar, the metres of the shortest walk that leads near enough.
      left: float32 scalar, the least metres left of any place so far.
      first: int32 scalar, turns that that walk begins with, or else the walk to the nearest place.
    """

    depth: jax.Array
    places: jax.Array
    walked: jax.Array
    firsts: jax.Array
    bound: jax.Array
    cost: jax.Array
    left: jax.Array
    first: jax.Array


def look(
    house: House, sight: Sight, wanted: jax.Array, state: HouseState
) -> tuple[jax.Array, jax.Array]:
    """Returns the next turn or look to see something from where the agent stands.

    Args:
      house: the dynamics.
      sight: of the agent.
      wanted: bool [N], which boxes to see.
      state: of the agent.

    Returns:
      An int32 scalar, one of `house.actions`, and a bool scalar, whether turning here helps.
    """
    points, seen = seen_points(sight, house.body, state.scene.boxes, wanted, state.position)
    eye = camera(state.position, house.body)
    turns = _turns(house)
    looks = jnp.zeros(1, jnp.int32)
    if "look_up" in house.actions:
        low, high = house.look_limits
        steps = int((high - low) / house.look)
        looks = jnp.arange(-steps, steps + 1, dtype=jnp.int32)

    def good(turn: jax.Array, tilt: jax.Array) -> jax.Array:
        yaw = state.yaw + turn.astype(jnp.float32) * jnp.float32(house.turn)
        pitch = state.pitch + tilt.astype(jnp.float32) * jnp.float32(house.look)
        allowed = (pitch >= house.look_limits[0] - 1e-3) & (pitch <= house.look_limits[1] + 1e-3)
        return allowed & jnp.any(seen & in_frustum(sight, eye, yaw, pitch, points))

    fits = jax.vmap(lambda turn: jax.vmap(lambda tilt: good(turn, tilt))(looks))(turns)
    effort = jnp.abs(turns)[:, None] + jnp.abs(looks)
    effort = jnp.where(fits, effort, jnp.iinfo(jnp.int32).max)
    best = jnp.argmin(effort)
    turn, tilt = turns[best // looks.shape[0]], looks[best % looks.shape[0]]
    names = ["rotate_left", "rotate_right"]
    names += ["look_up", "look_down"] if "look_up" in house.actions else names
    table = jnp.array([house.actions.index(name) for name in names], jnp.int32)
    action = jnp.where(
        turn != 0, table[(turn > 0).astype(jnp.int32)], table[2 + (tilt > 0).astype(jnp.int32)]
    )
    return action, jnp.any(fits)


def _turns(house: House) -> jax.Array:
    """Returns how many turns to the right each heading is, int32; negative to the left."""
    count = round(360 / house.turn)
    turns = jnp.arange(count, dtype=jnp.int32)
    return jnp.where(turns <= count // 2, turns, turns - count)
