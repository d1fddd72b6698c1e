"""Shortest walks of an agent that turns by right angles and so stays on a lattice: exact.

Moves of one length that fail whole and turns by 90° from one of the four axes lead only to places
at whole numbers of steps from the start. On these, how far each pose is from one in which a box is
visible is found by search, once an episode; then a step is a look into a table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.collision import is_free, obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.scene import CENTER, COSINE, SINE, Scene
from envs_jax.houses.state import HouseState
from envs_jax.houses.visibility import Sight, camera, in_frustum, seen_points

NO_WAY, SEES, AHEAD, RIGHT, LEFT = range(5)
# What a move costs; a turn costs 1. Walks are as short as can be, and then have few turns.
_MOVE = 64
_FAR = 1 << 20
# Metres of room that moves are planned with, since those that touch anything fail.
_ROOM = 1e-3
# At most so many places, the nearest to a box, are looked from.
_LOOKS = 256
# How far from a place of the lattice one still stands on it, metres and degrees.
_OFF, _TURNED = 1e-2, 1.0
# The plan steps of the headings 0°, 90°, 180° and 270°.
_WAYS = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]], np.int32)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lattice:
    """How shortest walks on a lattice go on.

    Attributes:
      origin: float32 [2], the plan of the first place.
      moves: uint8 [X, Z, 4], one of `NO_WAY`, `SEES`, `AHEAD`, `RIGHT` and `LEFT` for each place
        and heading 0°, 90°, 180° and 270°; to look up or down is all that is left to who sees.
    """

    origin: jax.Array
    moves: jax.Array


def fits(house: House) -> bool:
    """Returns whether an agent stays on a lattice."""
    return house.turn == 90 and house.collision == "fail" and house.noise is None


def survey(house: House, sight: Sight, scene: Scene, wanted: jax.Array, size: int) -> Lattice:
    """Finds the shortest walks to where something is visible, on the multiples of a step.

    Args:
      house: the dynamics.
      sight: of the agent.
      scene: as it stands.
      wanted: bool [N], which boxes to see.
      size: X and Z, how many places there are along each axis from the rooms' lowest corner on.
    """
    step, body, boxes = house.step_size, house.body, scene.boxes
    low = jnp.floor(jnp.min(scene.rooms[:, :2], axis=0) / step) * step
    axis = jnp.arange(size, dtype=jnp.float32) * step
    places = jnp.stack(jnp.meshgrid(low[0] + axis, low[1] + axis, indexing="ij"), axis=-1)
    blocked = obstacles(boxes, body)
    flat = places.reshape(-1, 2)
    ways = jnp.asarray(_WAYS[:2], jnp.float32) * step
    gaps = _gaps(blocked, flat, ways[:, None])
    ahead = (gaps >= body.radius + _ROOM).reshape(2, size, size)
    free = jax.vmap(lambda place: is_free(blocked, body.radius + _ROOM, place))(flat)
    # A way out of an obstacle is open, but not the way back: both ends have to be free.
    free = jnp.pad(free.reshape(size, size), ((0, 1), (0, 1)))
    onward = jnp.stack([free[:-1, 1:], free[1:, :-1]])
    ahead &= free[:-1, :-1] & onward
    # The way back is as open as the way there.
    back = [jnp.zeros_like(ahead[0]).at[:, 1:].set(ahead[0][:, :-1])]
    back += [jnp.zeros_like(ahead[0]).at[1:].set(ahead[1][:-1])]
    is_way_open = jnp.stack([*ahead, *back], axis=-1)
    sees = _seeing(house, sight, scene, wanted, flat).reshape(size, size, 4)
    first = jnp.where(sees, 0, _FAR).astype(jnp.int32)

    def continued(costs: jax.Array) -> jax.Array:
        """Returns int32 [X, Z, 4, 3]: the costs of a move, a turn right and a turn left first."""
        padded = jnp.pad(costs, ((1, 1), (1, 1), (0, 0)), constant_values=_FAR)
        onward = jnp.stack(
            [
                padded[1 + x : 1 + x + size, 1 + z : 1 + z + size, heading]
                for heading, (x, z) in enumerate(_WAYS.tolist())
            ],
            axis=-1,
        )
        onward = jnp.where(is_way_open, onward + _MOVE, _FAR)
        return jnp.stack(
            [onward, jnp.roll(costs, -1, axis=-1) + 1, jnp.roll(costs, 1, axis=-1) + 1], axis=-1
        )

    def relax(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        costs, _ = carry
        better = jnp.minimum(costs, jnp.min(continued(costs), axis=-1))
        return better, jnp.any(better < costs)

    costs, _ = jax.lax.while_loop(lambda carry: carry[1], relax, (first, jnp.bool_(True)))
    moves = AHEAD + jnp.argmin(continued(costs), axis=-1)
    moves = jnp.where(sees, SEES, jnp.where(costs < _FAR, moves, NO_WAY))
    return Lattice(low, moves.astype(jnp.uint8))


def is_reachable(lattice: Lattice, step_size: float, position: jax.Array) -> jax.Array:
    """Returns a bool scalar: whether a walk leads from a plan float32 [2] to where one sees."""
    cell, on = _cell(lattice, step_size, position)
    return on & (lattice.moves[cell[0], cell[1], 0] != NO_WAY)


def walk(house: House, lattice: Lattice, state: HouseState) -> tuple[jax.Array, jax.Array]:
    """Returns the next action of a shortest walk.

    Args:
      house: the dynamics.
      lattice: to walk on.
      state: of the agent.

    Returns:
      An int32 scalar, one of `house.actions`, and a bool scalar, whether there is such a walk: the
      agent may stand beside the lattice, or where none leads to the goal.
    """
    cell, on = _cell(lattice, house.step_size, state.position)
    heading = jnp.round(state.yaw / 90).astype(jnp.int32)
    on &= jnp.abs(state.yaw - 90 * heading.astype(jnp.float32)) < _TURNED
    move = lattice.moves[cell[0], cell[1], heading % 4]
    names = ("move_ahead", "rotate_right", "rotate_left")
    actions = jnp.array([house.actions.index(name) for name in names], jnp.int32)
    return actions[jnp.maximum(move.astype(jnp.int32) - AHEAD, 0)], on & (move >= AHEAD)


def _cell(lattice: Lattice, step_size: float, position: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns int32 [2], the place next to a plan, and a bool scalar, whether the plan is there."""
    steps = (position - lattice.origin) / step_size
    nearest = jnp.round(steps)
    last = jnp.array(lattice.moves.shape[:2], jnp.int32) - 1
    cell = jnp.clip(nearest.astype(jnp.int32), 0, last)
    on = jnp.all(jnp.abs(steps - cell.astype(jnp.float32)) * step_size < _OFF)
    return cell, on


def _gaps(boxes: jax.Array, starts: jax.Array, moves: jax.Array) -> jax.Array:
    """Returns the metres [...] between moves and all rectangles, where both ends are outside.

    Between a segment and a rectangle the way is shortest from an end or from a corner.

    Args:
      boxes: float32 [N, 8].
      starts: float32 [..., 2], plans.
      moves: float32 [..., 2], not 0; may broadcast.
    """
    # Taken apart, as in `geodesic.visible`.
    start_x, start_z = starts[..., 0], starts[..., 1]
    move_x, move_z = moves[..., 0], moves[..., 1]

    def meet(least: jax.Array, box: jax.Array) -> tuple[jax.Array, None]:
        x, z = start_x - box[0], start_z - box[2]
        cosine, sine = box[COSINE], box[SINE]
        x, z = cosine * x - sine * z, sine * x + cosine * z
        u, v = cosine * move_x - sine * move_z, sine * move_x + cosine * move_z
        size_x, size_z = box[3], box[5]
        middle_x, middle_z = x + u / 2, z + v / 2
        beyond_x = jnp.abs(middle_x) - jnp.abs(u) / 2 - size_x
        beyond_z = jnp.abs(middle_z) - jnp.abs(v) / 2 - size_z
        across = jnp.abs(x * v - z * u) - size_x * jnp.abs(v) - size_z * jnp.abs(u)
        crosses = jnp.maximum(jnp.maximum(beyond_x, beyond_z), across) <= 0
        squared = jnp.where(crosses, 0, least)
        for side_x, side_z in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            to_x, to_z = x - side_x * size_x, z - side_z * size_z
            share = jnp.clip(-(to_x * u + to_z * v) / (u * u + v * v), 0, 1)
            squared = jnp.minimum(squared, (to_x + share * u) ** 2 + (to_z + share * v) ** 2)
        return squared, None

    shape = jnp.broadcast_shapes(starts.shape, moves.shape)[:-1]
    squared, _ = jax.lax.scan(meet, jnp.full(shape, jnp.inf, jnp.float32), boxes)
    return jnp.sqrt(squared)


def _seeing(
    house: House, sight: Sight, scene: Scene, wanted: jax.Array, places: jax.Array
) -> jax.Array:
    """Returns bool [P, 4]: at which places and headings the nearest wanted box can be seen."""
    boxes, body = scene.boxes, house.body
    single = replace(sight, instances=1)
    centers = jnp.where(wanted[:, None], boxes[:, CENTER][:, ::2], jnp.inf)
    away = jnp.min(jnp.max(jnp.abs(places[:, None] - centers), axis=-1), axis=1)
    _, near = jax.lax.top_k(-away, min(_LOOKS, places.shape[0]))
    low, high = house.look_limits
    count = int((high - low) / house.look) + 1
    pitches = low + house.look * jnp.arange(count, dtype=jnp.float32)
    yaws = 90 * jnp.arange(4, dtype=jnp.float32)

    def look(place: jax.Array) -> jax.Array:
        points, seen = seen_points(single, body, boxes, wanted, place)
        eye = camera(place, body)

        def good(yaw: jax.Array, pitch: jax.Array) -> jax.Array:
            return jnp.any(seen & in_frustum(sight, eye, yaw, pitch, points))

        return jnp.any(
            jax.vmap(lambda yaw: jax.vmap(lambda pitch: good(yaw, pitch))(pitches))(yaws), axis=1
        )

    found = jax.vmap(look)(places[near])
    return jnp.zeros((places.shape[0], 4), bool).at[near].set(found)
