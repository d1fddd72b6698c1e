"""Rectangles cut into rooms: walls, doorways, windows and what must stay clear before them.

A floor is a rectangle that is cut in two again and again, each time across the longer side of some
room, by a wall with one doorway. The doorway keeps away from the ends of all walls that meet its
own, so that it joins one room on either side; by induction all rooms are joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.draws import Shape

HALF_WALL = 0.05
NARROWEST_DOOR = 0.9
# A doorway may be as close to the middle of a wall that meets its own.
_BESIDE_DOOR = HALF_WALL + 0.01
# With sides of at least this length the longest stretch of a wall between two that meet it is more
# than half as long: enough for the narrowest doorway.
SHORTEST_SIDE = 2.2
# How far before a doorway nothing may stand.
_DOOR_DEPTH = 0.6
_DOOR_HEIGHT = 2.1
# By how much doors and windows stand out from the walls that they are in, so as to be seen.
_RELIEF = 0.004
_KITCHEN, _LIVING, _BEDROOM, _BATHROOM = (
    categories.ROOMS.index(name) for name in ("Kitchen", "LivingRoom", "Bedroom", "Bathroom")
)
# By the number of rooms, what the largest is, the next, and so on.
_KINDS = np.array(
    [
        [_LIVING, 0, 0, 0, 0, 0, 0, 0],
        [_LIVING, _BEDROOM, 0, 0, 0, 0, 0, 0],
        [_LIVING, _KITCHEN, _BEDROOM, 0, 0, 0, 0, 0],
        [_LIVING, _KITCHEN, _BEDROOM, _BATHROOM, 0, 0, 0, 0],
        [_LIVING, _KITCHEN, _BEDROOM, _BEDROOM, _BATHROOM, 0, 0, 0],
        [_LIVING, _KITCHEN, _BEDROOM, _BEDROOM, _BEDROOM, _BATHROOM, 0, 0],
        [_LIVING, _KITCHEN, _BEDROOM, _BEDROOM, _BEDROOM, _BATHROOM, _BATHROOM, 0],
        [_LIVING, _KITCHEN, _BEDROOM, _LIVING, _BEDROOM, _BEDROOM, _BATHROOM, _BATHROOM],
    ],
    np.int32,
)
MOST_ROOMS = len(_KINDS)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FloorPlan:
    """A floor without furniture.

    Attributes:
      structure: float32 [W, 6], walls, lintels, a door and windows as corners (x, y, z) low and
        (x, y, z) high; without size if unused.
      category: int32 [W], what they are.
      rooms: float32 [R, 4], the rooms between the faces of their walls as (x low, z low, x high,
        z high); without area if unused.
      kind: int32 [R], index into `categories.ROOMS`.
      clear: float32 [D, 4], rectangles in which nothing may stand.
      ceiling: float32 scalar.
    """

    structure: jax.Array
    category: jax.Array
    rooms: jax.Array
    kind: jax.Array
    clear: jax.Array
    ceiling: jax.Array


def shapes(most_rooms: int) -> tuple[Shape, ...]:
    """Returns the shapes of the random numbers that `draw_plan` takes."""
    walls = most_rooms - 1
    return ((), (most_rooms,), (walls, 3), (most_rooms, 5), (most_rooms + 1,))


def draw_plan(
    draws: Sequence[jax.Array],
    size: jax.Array,
    rooms: jax.Array,
    most_rooms: int,
    widest_door: float,
    lintels: bool,
) -> FloorPlan:
    """Draws a floor of up to so many rooms; all work is of fixed size.

    Args:
      draws: uniform float32 of `shapes`.
      size: float32 [2], the floor's extent along x and z, from wall to wall.
      rooms: int32 scalar, how many rooms to make if they are not to become too small.
      most_rooms: the greatest value of `rooms`.
      widest_door: metres.
      lintels: whether there is wall above doorways.
    """
    height, cuts, doors, windows, entries = draws
    ceiling = 2.5 + 0.5 * height
    cells, walls = _split(cuts, size, rooms)
    holes = _doorways(doors, walls, widest_door)
    used = cells[:, 2] > cells[:, 0]
    interior = cells + HALF_WALL * jnp.array([1, 1, -1, -1], jnp.float32)
    interior = jnp.where(used[:, None], interior, 0.0)
    entrance, before_entrance = _entrance(entries, interior)
    parts = [
        (_outer_walls(size, ceiling), "Wall"),
        (_inner_walls(walls, holes, ceiling, lintels), "Wall"),
        (entrance[None], "Door"),
        (_windows(windows, cells, used, size), "Window"),
    ]
    category = [np.full(len(rows), categories.index(name), np.int32) for rows, name in parts]
    structure = jnp.concatenate([rows for rows, _ in parts])
    there = structure[:, 3] > structure[:, 0]
    return FloorPlan(
        structure=structure,
        category=jnp.where(there, jnp.concatenate(category), 0),
        rooms=interior,
        kind=_kinds(cells, used),
        clear=jnp.concatenate([_before(walls, holes), before_entrance[None]]),
        ceiling=ceiling,
    )


def _split(draws: jax.Array, size: jax.Array, rooms: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cuts the floor into cells float32 [R, 4], between the middles of their walls.

    The walls are float32 [R − 1, 4]: 0 if it runs along x and 1 if along z, its other coordinate,
    and from where to where it runs; nowhere if it was not built.
    """
    most_rooms = len(draws)
    cells = jnp.zeros((most_rooms, 4), jnp.float32).at[0, 2:].set(size)

    def cut(cells: jax.Array, i: jax.Array) -> tuple[jax.Array, jax.Array]:
        sides = cells[:, 2:] - cells[:, :2]
        room_to_cut = jnp.max(sides, axis=1) >= 2 * SHORTEST_SIDE
        area = sides[:, 0] * sides[:, 1]
        chosen = jnp.argmax(jnp.where(room_to_cut, area, -1.0))
        build = (i + 1 < rooms) & room_to_cut[chosen]
        cell = cells[chosen]
        along_z = sides[chosen, 0] >= sides[chosen, 1]
        low, high = jnp.where(along_z, cell[0], cell[1]), jnp.where(along_z, cell[2], cell[3])
        near = jnp.maximum(low + SHORTEST_SIDE, low + 0.3 * (high - low))
        far = jnp.minimum(high - SHORTEST_SIDE, high - 0.3 * (high - low))
        at = near + draws[i] * (far - near)
        lower = jnp.where(along_z, cell.at[2].set(at), cell.at[3].set(at))
        upper = jnp.where(along_z, cell.at[0].set(at), cell.at[1].set(at))
        cells = jnp.where(build, cells.at[chosen].set(lower).at[i + 1].set(upper), cells)
        start, end = jnp.where(along_z, cell[1], cell[0]), jnp.where(along_z, cell[3], cell[2])
        wall = jnp.stack([along_z.astype(jnp.float32), at, start, end])
        return cells, jnp.where(build, wall, jnp.float32(0))

    return jax.lax.scan(cut, cells, jnp.arange(most_rooms - 1, dtype=jnp.int32))


def _doorways(draws: jax.Array, walls: jax.Array, widest: float) -> jax.Array:
    """Returns from where to where each wall is open, float32 [R − 1, 2]."""
    count = len(walls)
    if not count:
        return jnp.zeros((0, 2), jnp.float32)
    direction, at, start, end = walls.T
    crosses = direction[:, None] != direction[None]
    ends_here = (start[None] == at[:, None]) | (end[None] == at[:, None])
    within = (at[None] > start[:, None]) & (at[None] < end[:, None])
    meets = crosses & ends_here & within & (end > start)[None]
    # The stretches of a wall between those that meet it; the unused ones have no length.
    ends = jnp.where(meets, at[None], end[:, None])
    ends = _sorted(jnp.concatenate([start[:, None], ends, end[:, None]], axis=1))
    length = ends[:, 1:] - ends[:, :-1] - 2 * _BESIDE_DOOR
    # Where none will do, which rounding could bring about, the longest is the best there is.
    weight = jnp.where(length >= NARROWEST_DOOR, length, 1e-6 * jnp.maximum(length, 0.0))
    sums = jnp.cumsum(weight, axis=1)
    chosen = jnp.sum(sums < draws[:, :1] * sums[:, -1:], axis=1)
    row = jnp.arange(count, dtype=jnp.int32)
    longest, low = length[row, chosen], ends[row, chosen] + _BESIDE_DOOR
    width = NARROWEST_DOOR + draws[:, 1] * (widest - NARROWEST_DOOR)
    width = jnp.minimum(width, longest)
    begin = low + draws[:, 2] * (longest - width)
    hole = jnp.stack([begin, begin + width], axis=1)
    return jnp.where((end > start)[:, None], hole, jnp.float32(0))


def _ranks(values: jax.Array) -> jax.Array:
    """Returns int32 [..., n]: how many come before each of `values`; of equals, the first does.

    Of so few, comparing all with all is cheaper than a sort, to compile as well as to run.
    """
    row = jnp.arange(values.shape[-1], dtype=jnp.int32)
    one, other = values[..., :, None], values[..., None, :]
    before = (other < one) | ((other == one) & (row < row[:, None]))
    return jnp.sum(before, axis=-1, dtype=jnp.int32)


def _sorted(values: jax.Array) -> jax.Array:
    """Returns `values` [..., n] in ascending order."""
    place = _ranks(values)[..., None, :] == jnp.arange(values.shape[-1], dtype=jnp.int32)[:, None]
    return jnp.sum(jnp.where(place, values[..., None, :], 0.0), axis=-1)


def _oriented(walls: jax.Array, spans: jax.Array, half: float) -> jax.Array:
    """Returns rectangles [n, 4] as thick as 2 `half` about walls [n, 4], over spans [n, 2]."""
    at, low, high = walls[:, 1], spans[:, 0], spans[:, 1]
    along_x = jnp.stack([low, at - half, high, at + half], axis=1)
    along_z = jnp.stack([at - half, low, at + half, high], axis=1)
    rectangles = jnp.where(walls[:, :1] > 0, along_z, along_x)
    return jnp.where((high - low > 1e-3)[:, None], rectangles, 0.0)


def _raise(rectangles: jax.Array, low: jax.Array | float, high: jax.Array | float) -> jax.Array:
    """Returns boxes [n, 6] on rectangles [n, 4], from height `low` to `high`."""
    there = rectangles[:, 2] > rectangles[:, 0]
    count = len(rectangles)
    low = jnp.where(there, jnp.broadcast_to(jnp.float32(low), (count,)), 0.0)
    high = jnp.where(there, jnp.broadcast_to(jnp.float32(high), (count,)), 0.0)
    x_low, z_low, x_high, z_high = rectangles.T
    return jnp.stack([x_low, low, z_low, x_high, high, z_high], axis=1)


def _outer_walls(size: jax.Array, ceiling: jax.Array) -> jax.Array:
    """Returns the four walls round the floor, float32 [4, 6]."""
    zero, thick = jnp.float32(0), jnp.float32(HALF_WALL)
    x, z = size[0], size[1]
    rectangles = [
        [-thick, -thick, x + thick, thick],
        [-thick, z - thick, x + thick, z + thick],
        [-thick, zero, thick, z],
        [x - thick, zero, x + thick, z],
    ]
    return _raise(jnp.stack([jnp.stack(row) for row in rectangles]), 0.0, ceiling)


def _inner_walls(
    walls: jax.Array, holes: jax.Array, ceiling: jax.Array, lintels: bool
) -> jax.Array:
    """Returns the walls on either side of each doorway and above it, float32 [2 or 3 · n, 6]."""
    before = jnp.stack([walls[:, 2], holes[:, 0]], axis=1)
    after = jnp.stack([holes[:, 1], walls[:, 3]], axis=1)
    parts = [_raise(_oriented(walls, span, HALF_WALL), 0.0, ceiling) for span in (before, after)]
    if lintels:
        parts.append(_raise(_oriented(walls, holes, HALF_WALL), _DOOR_HEIGHT, ceiling))
    return jnp.concatenate(parts)


def _before(walls: jax.Array, holes: jax.Array) -> jax.Array:
    """Returns what must stay clear on both sides of each doorway, float32 [n, 4]."""
    return _oriented(walls, holes, HALF_WALL + _DOOR_DEPTH)


def _entrance(draws: jax.Array, interior: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns a shut door in the wall of least z, [6], and what is to stay clear before it, [4]."""
    outside = (interior[:, 1] < 2 * HALF_WALL) & (interior[:, 2] > interior[:, 0])
    room = interior[jnp.argmax(jnp.where(outside, draws[1:], -1.0))]
    low = room[0] + 0.2 + draws[0] * (room[2] - room[0] - NARROWEST_DOOR - 0.4)
    high = low + NARROWEST_DOOR
    front = jnp.float32(HALF_WALL + _RELIEF)
    door = [low, jnp.float32(0), -front, high, jnp.float32(2.0), front]
    # Beside it too: it must not make what is just wide enough for a body too narrow.
    clear = [low - 0.5, jnp.float32(0), high + 0.5, jnp.float32(_DOOR_DEPTH + HALF_WALL)]
    return jnp.stack(door), jnp.stack(clear)


def _windows(draws: jax.Array, cells: jax.Array, used: jax.Array, size: jax.Array) -> jax.Array:
    """Returns a window for each room that has an outer wall without the entrance, [R, 6]."""
    x_low, z_low, x_high, z_high = cells.T
    at_edge = jnp.stack([x_low <= 0, x_high >= size[0], z_high >= size[1]], axis=1)
    chosen = jnp.argmax(jnp.where(at_edge, draws[:, :3], -1.0), axis=1)
    along_z = chosen < 2
    at = jnp.where(chosen == 0, 0.0, jnp.where(chosen == 1, size[0], size[1]))
    low, high = jnp.where(along_z, z_low, x_low), jnp.where(along_z, z_high, x_high)
    width = 0.8 + 0.8 * draws[:, 3]
    begin = low + 0.2 + draws[:, 4] * (high - low - width - 0.4)
    there = used & jnp.any(at_edge, axis=1)
    span = jnp.where(there[:, None], jnp.stack([begin, begin + width], axis=1), 0.0)
    walls = jnp.stack([along_z.astype(jnp.float32), at, low, high], axis=1)
    return _raise(_oriented(walls, span, HALF_WALL + _RELIEF), 1.0, 2.0)


def _kinds(cells: jax.Array, used: jax.Array) -> jax.Array:
    """Returns what each room is, by its rank in area, int32 [R]."""
    area = (cells[:, 2] - cells[:, 0]) * (cells[:, 3] - cells[:, 1])
    rank = _ranks(-area)
    kinds = jnp.asarray(_KINDS)[jnp.sum(used, dtype=jnp.int32) - 1]
    return jnp.where(used, kinds[rank], 0)
