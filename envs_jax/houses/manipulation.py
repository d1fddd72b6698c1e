"""Opening and carrying the nearest thing in front."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import clearance, obstacles
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, NOWHERE, SINE, forward, to_local
from envs_jax.houses.state import Body, HouseState
from envs_jax.houses.visibility import camera, entries, met_first

# Half the angle, in degrees, of what is in front.
_IN_FRONT = 45.0
# Metres from the body's surface at which things are put down.
_PUT_DOWN = 0.25
_LIFT = 1e-3


def open_nearest(state: HouseState, body: Body, reach: float) -> HouseState:
    """Opens the nearest shut thing in front, unless it would hit the agent."""
    return _swap(state, body, reach, state.scene.openable & ~state.scene.opened)


def close_nearest(state: HouseState, body: Body, reach: float) -> HouseState:
    """Shuts the nearest open thing in front, unless it would hit the agent."""
    return _swap(state, body, reach, state.scene.openable & state.scene.opened)


def pick_up(state: HouseState, body: Body, reach: float) -> HouseState:
    """Takes the nearest portable thing in front, if the agent holds nothing."""
    scene = state.scene
    row, found = _nearest_in_front(state, body, reach, scene.portable)
    found &= state.held < 0
    # Only the height changes, so that its size and heading are known when it is put down.
    boxes = scene.boxes.at[row, 1].add(jnp.where(found, NOWHERE, 0))
    return replace(state, scene=replace(scene, boxes=boxes), held=jnp.where(found, row, state.held))


def put_down(state: HouseState, body: Body, reach: float) -> HouseState:
    """Puts what is held onto what is in front, or onto the floor, if there is room.

    It lands on the highest box below the camera at a point in front of the body, and is refused
    where it would touch anything else or there is something between.
    """
    del reach
    scene = state.scene
    row = jnp.maximum(state.held, 0)
    ahead = forward(state.yaw)
    held = scene.boxes[row]
    half = held[HALF_SIZE]
    gap = body.radius + _PUT_DOWN + jnp.maximum(half[0], half[2])
    plan = state.position + gap * ahead
    inside = jnp.all(
        jnp.abs(to_local(scene.boxes, plan)) <= scene.boxes[:, HALF_SIZE][:, ::2], axis=-1
    )
    tops = scene.boxes[:, 1] + scene.boxes[:, HALF_SIZE][:, 1]
    below = inside & scene.present & (tops < body.camera_height)
    surface = jnp.max(jnp.where(below, tops, 0))
    center = jnp.stack([plan[0], surface + half[1] + _LIFT, plan[1]])
    placed = held.at[CENTER].set(center)
    shares = entries(scene.boxes, camera(state.position, body), center[None])[0]
    room = ~jnp.any(_overlaps(scene.boxes, placed)) & ~jnp.any(shares < 1) & (state.held >= 0)
    # What can be opened goes on being opened from where it is now.
    moved = center - held[CENTER].at[1].add(-NOWHERE)
    boxes = scene.boxes.at[row].set(jnp.where(room, placed, held))
    others = scene.other_boxes.at[row, CENTER].add(jnp.where(room, moved, 0))
    return replace(
        state,
        scene=replace(scene, boxes=boxes, other_boxes=others),
        held=jnp.where(room, -1, state.held),
    )


ACTS: dict[str, Callable[[HouseState, Body, float], HouseState]] = {
    "open": open_nearest,
    "close": close_nearest,
    "pick_up": pick_up,
    "put_down": put_down,
}


def _swap(state: HouseState, body: Body, reach: float, allowed: jax.Array) -> HouseState:
    """Exchanges the two places of the nearest allowed box in front."""
    scene = state.scene
    row, found = _nearest_in_front(state, body, reach, allowed)
    here, there = scene.boxes[row], scene.other_boxes[row]
    gap, _ = clearance(obstacles(there[None], body), state.position)
    found &= gap[0] >= body.radius
    scene = replace(
        scene,
        boxes=scene.boxes.at[row].set(jnp.where(found, there, here)),
        other_boxes=scene.other_boxes.at[row].set(jnp.where(found, here, there)),
        opened=scene.opened.at[row].set(scene.opened[row] ^ found),
    )
    return replace(state, scene=scene)


def _nearest_in_front(
    state: HouseState, body: Body, reach: float, allowed: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Returns the row of the nearest allowed box in front, and whether there is one in reach.

    It must not be hidden from the camera where it is nearest.
    """
    boxes = state.scene.boxes
    away, way = clearance(boxes, state.position)
    ahead = -(way @ forward(state.yaw))
    near = allowed & (away > 0) & (away <= reach) & (ahead >= math.cos(math.radians(_IN_FRONT)))
    row = jnp.argmin(jnp.where(near, away, jnp.inf)).astype(jnp.int32)
    box = boxes[row]
    plan = state.position - (away[row] + _LIFT) * way[row]
    low, high = box[1] - box[HALF_SIZE][1] + _LIFT, box[1] + box[HALF_SIZE][1] - _LIFT
    point = jnp.stack([plan[0], jnp.clip(jnp.float32(body.camera_height), low, high), plan[1]])
    seen = met_first(boxes, row, camera(state.position, body), point[None], 2 * reach)[0]
    return row, near[row] & seen


def _overlaps(boxes: jax.Array, placed: jax.Array) -> jax.Array:
    """Returns bool [N]: which boxes a box float32 [8] touches."""
    offset = boxes[:, CENTER] - placed[CENTER]
    half, other = placed[HALF_SIZE], boxes[:, HALF_SIZE]
    axes = jnp.stack([placed[COSINE], -placed[SINE]]), jnp.stack([placed[SINE], placed[COSINE]])
    mine = jnp.stack(axes)
    theirs = jnp.stack(
        [
            jnp.stack([boxes[:, COSINE], -boxes[:, SINE]], axis=-1),
            jnp.stack([boxes[:, SINE], boxes[:, COSINE]], axis=-1),
        ],
        axis=1,
    )
    apart = jnp.abs(offset[:, 1]) >= half[1] + other[:, 1]
    # Rectangles that do not touch are apart along a side of one of them.
    for axis in (mine[0], mine[1], theirs[:, 0], theirs[:, 1]):
        axis = jnp.broadcast_to(axis, (boxes.shape[0], 2))
        between = jnp.abs(jnp.sum(offset[:, ::2] * axis, axis=-1))
        spread = jnp.abs(axis @ mine.T) @ half[::2]
        theirs_along = jnp.abs(jnp.sum(theirs * axis[:, None], axis=-1))
        spread += jnp.sum(theirs_along * other[:, ::2], axis=-1)
        apart |= between >= spread
    return ~apart
