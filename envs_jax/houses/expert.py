"""Experts that walk and look as the agent can: in its steps and turns, into nothing."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import GoalField, distance, nearby
from envs_jax.houses.scene import forward
from envs_jax.houses.state import HouseState
from envs_jax.houses.visibility import Sight, camera, in_frustum, seen_points

# Metres that each turn counts for, to choose between headings that are as good.
_TURN_COST = 1e-3
# How many nodes of the way it plans with, and how near they are if not seen, in metres.
_NODES, _NEAR = 24, 0.75
# A step that leads no nearer than this, in metres, ends in a corner: it then prefers any step at
# random, by up to so much.
_GAIN, _LUCK = 0.02, 0.4


def walk(house: House, field: GoalField, state: HouseState, walked: jax.Array) -> jax.Array:
    """Returns the next action of a short way to the nearest goal.

    Of all headings that turns lead to, it takes the one in which a step ahead leaves the shortest
    way. In a corner from which no step leads nearer it tries one at random, and sticks to it while
    it turns there. That leads out of most corners, not of all: where moves that touch anything fail
    and headings are few, it can stay in one until time is up.

    Args:
      house: the dynamics; noise is left out of account.
      field: of the goals.
      state: of the agent.
      walked: float32 scalar, metres since the start, by which it draws at random.

    Returns:
      An int32 scalar, one of `house.actions`.
    """
    boxes, radius = obstacles(state.scene.boxes, house.body), house.body.radius
    turns = _turns(house)
    now, _ = distance(field, boxes, radius, state.position)
    field = nearby(field, boxes, radius, state.position, _NODES, _NEAR)
    # A draw belongs to a heading, so that turning does not change it.
    heading = jnp.round(state.yaw / jnp.float32(house.turn)).astype(jnp.int32)

    def ahead(turn: jax.Array) -> jax.Array:
        way = forward(state.yaw + turn.astype(jnp.float32) * jnp.float32(house.turn))
        place, _ = house.move(boxes, state.position, jnp.float32(house.step_size) * way)
        left, _ = distance(field, boxes, radius, place)
        stays = jnp.sum((place - state.position) ** 2) < 1e-6
        return jnp.where(stays, jnp.inf, left)

    left = jax.vmap(ahead)(turns)
    bits = jax.lax.bitcast_convert_type(walked, jnp.uint32)
    draw = jax.random.fold_in(jax.random.key(0), bits)
    luck = _LUCK * jax.random.uniform(draw, turns.shape, jnp.float32)
    stuck = jnp.min(left) > now - _GAIN
    left += jnp.where(stuck, luck[(heading + turns) % turns.shape[0]], 0)
    turn = turns[jnp.argmin(left + _TURN_COST * jnp.abs(turns).astype(jnp.float32))]
    names = ("rotate_left", "move_ahead", "rotate_right")
    return jnp.array([house.actions.index(name) for name in names], jnp.int32)[jnp.sign(turn) + 1]


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
