"""Experts that walk and look as the agent can: in its steps and turns, into nothing."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import GoalField, distance
from envs_jax.houses.scene import forward
from envs_jax.houses.state import HouseState
from envs_jax.houses.visibility import Sight, camera, in_frustum, seen_points

# Metres that each turn counts for, to choose between headings that are as good.
_TURN_COST = 1e-3


def walk(house: House, field: GoalField, state: HouseState, key: jax.Array) -> jax.Array:
    """Returns the next action of a short way to the nearest goal.

    Of all headings that turns lead to, it takes the one in which a step ahead leaves the shortest
    way.

    Args:
      house: the dynamics; noise is left out of account.
      field: of the goals.
      state: of the agent.
      key: a PRNG key, for a way out of where no step leads nearer.

    Returns:
      An int32 scalar, one of `house.actions`.
    """
    boxes = obstacles(state.scene.boxes, house.body)
    count = round(360 / house.turn)
    turns = jnp.arange(count, dtype=jnp.int32)
    turns = jnp.where(turns <= count // 2, turns, turns - count)

    def ahead(turn: jax.Array) -> jax.Array:
        way = forward(state.yaw + turn.astype(jnp.float32) * jnp.float32(house.turn))
        place, _ = house.move(boxes, state.position, jnp.float32(house.step_size) * way)
        left, _ = distance(field, boxes, house.body.radius, place)
        stays = jnp.sum((place - state.position) ** 2) < 1e-6
        return jnp.where(stays, jnp.inf, left)

    left = jax.vmap(ahead)(turns)
    now, _ = distance(field, boxes, house.body.radius, state.position)
    stuck = jnp.min(left) >= now - 1e-3
    left += jnp.where(stuck, jax.random.uniform(key, (count,), jnp.float32), 0)
    turn = turns[jnp.argmin(left + _TURN_COST * jnp.abs(turns).astype(jnp.float32))]
    choice = jnp.sign(turn)
    names = ("rotate_left", "move_ahead", "rotate_right")
    return jnp.array([house.actions.index(name) for name in names], jnp.int32)[choice + 1]


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
    count = round(360 / house.turn)
    turns = jnp.arange(count, dtype=jnp.int32)
    turns = jnp.where(turns <= count // 2, turns, turns - count)
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
