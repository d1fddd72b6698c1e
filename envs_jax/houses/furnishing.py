"""Furniture along walls and in the open, and things on it, none of it in anyone's way.

Why the free space of a body of up to `WIDEST_BODY` metres radius stays one piece: what stands at a
wall touches it, and keeps `PASSAGE` from all that does not stand at the same wall, and from the
other walls unless it stands in a corner, too close to the other wall for any body; what stands in
the open keeps `PASSAGE` from everything. So the things that the body cannot pass between form, with
the walls, lumps that touch a room's border in one stretch each, and a rectangle without such lumps
is connected. Nowhere is a body between a piece and a wall with a window so that it could just pass
beside the window, which stands out, and not before it. Before doorways nothing stands.

Before what stands at a wall, between its neighbours, the body has room. Things lie within 3 cm of
an edge that the body can come to: the front of what stands at a wall, and the ends of what stands
in the open (chairs are at its sides).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.asset_sizes import RECEPTACLES, SIZES
from envs_jax.houses.draws import Shape
from envs_jax.houses.floor_plans import FloorPlan

WIDEST_BODY = 0.2
PASSAGE = 2 * WIDEST_BODY + 0.1
# What stands side by side at a wall; more beside what is narrow, so that one can stand before it
# however deep its neighbours are.
_SIDE_GAP = 0.1
_STANDING_ROOM = 2 * WIDEST_BODY + 0.04
_EDGE = 0.03
# Things on anything higher could not be seen, and things on what is as high as a camera only if
# they are not too flat. What is higher than the lowest camera hides things by its edge, from who
# stands before it, that are too deep for their height.
_HIGHEST_RECEPTACLE = 1.0
_EYE_LEVEL, _FLAT = 0.8, 0.06
_LOWEST_CAMERA = 0.87
_CHAIR_DEPTH = 0.5
_CANDIDATES = 16
# Where a piece of furniture goes.
AT_WALL, IN_OPEN, AT_TABLE = range(3)
OPEN, TABLE = 4, 5  # Beside the walls 0 … 3: x low, x high, z low, z high.
ABSENT = -1
# Cosine and sine of the yaw of what stands at a wall, with its back to it.
_FROM_WALL = np.array([[0, 1], [0, -1], [1, 0], [-1, 0]], np.float32)

# Assets that are L-shaped, have back rests or head boards, or are no box for other reasons, and
# televisions that most stands are too short for: a box with their bounds would be something else.
# Of bathtubs there are no assets.
_BOX_SIZES = {
    "Bathtub": ((1.4, 0.5, 0.7), (1.5, 0.55, 0.75), (1.7, 0.6, 0.8)),
    "Bed": ((0.9, 0.4, 1.9), (1.4, 0.5, 2.1), (1.8, 0.65, 2.2)),
    "Chair": ((0.36, 0.67, 0.37), (0.45, 0.85, 0.42), (0.5, 1.0, 0.46)),
    "CounterTop": ((0.8, 0.9, 0.58), (1.6, 0.93, 0.62), (2.4, 0.95, 0.65)),
    "Desk": ((0.83, 0.57, 0.4), (1.2, 0.75, 0.62), (1.6, 0.85, 0.8)),
    "Sink": ((0.46, 0.8, 0.4), (0.69, 0.85, 0.5), (1.2, 0.95, 0.6)),
    "Television": ((0.6, 0.4, 0.07), (0.85, 0.55, 0.12), (1.2, 0.75, 0.3)),
}
_KINDS = ("Kitchen", "LivingRoom", "Bedroom", "Bathroom")
# What stands in a kind of room, the most important first: category, where, how often.
_FURNITURE: dict[str, tuple[tuple[str, int, float], ...]] = {
    "Kitchen": (
        ("CounterTop", AT_WALL, 1.0),
        ("Fridge", AT_WALL, 1.0),
        ("DiningTable", IN_OPEN, 0.7),
        ("Chair", AT_TABLE, 0.9),
        ("Chair", AT_TABLE, 0.9),
        ("CounterTop", AT_WALL, 0.8),
        ("GarbageCan", AT_WALL, 0.6),
        ("SideTable", AT_WALL, 0.4),
        ("Chair", AT_TABLE, 0.6),
        ("ShelvingUnit", AT_WALL, 0.4),
        ("Stool", AT_WALL, 0.5),
        ("Chair", AT_TABLE, 0.6),
        ("CounterTop", AT_WALL, 0.5),
        ("HousePlant", AT_WALL, 0.4),
        ("Safe", AT_WALL, 0.1),
        ("Stool", AT_WALL, 0.3),
    ),
    "LivingRoom": (
        ("Sofa", AT_WALL, 1.0),
        ("TVStand", AT_WALL, 0.95),
        ("CoffeeTable", IN_OPEN, 0.8),
        ("SideTable", AT_WALL, 0.7),
        ("ArmChair", AT_WALL, 0.8),
        ("ShelvingUnit", AT_WALL, 0.5),
        ("Desk", AT_WALL, 0.5),
        ("DiningTable", IN_OPEN, 0.3),
        ("Chair", AT_TABLE, 0.9),
        ("Chair", AT_TABLE, 0.9),
        ("FloorLamp", AT_WALL, 0.6),
        ("HousePlant", AT_WALL, 0.5),
        ("Dresser", AT_WALL, 0.4),
        ("GarbageCan", AT_WALL, 0.5),
        ("ArmChair", AT_WALL, 0.4),
        ("SideTable", AT_WALL, 0.4),
    ),
    "Bedroom": (
        ("Bed", AT_WALL, 1.0),
        ("SideTable", AT_WALL, 0.9),
        ("Dresser", AT_WALL, 0.8),
        ("Desk", AT_WALL, 0.8),
        ("Chair", AT_WALL, 0.5),
        ("ShelvingUnit", AT_WALL, 0.4),
        ("ArmChair", AT_WALL, 0.3),
        ("GarbageCan", AT_WALL, 0.4),
        ("SideTable", AT_WALL, 0.4),
        ("FloorLamp", AT_WALL, 0.4),
        ("LaundryHamper", AT_WALL, 0.4),
        ("Ottoman", IN_OPEN, 0.2),
        ("HousePlant", AT_WALL, 0.3),
        ("TVStand", AT_WALL, 0.3),
        ("DogBed", AT_WALL, 0.2),
        ("Safe", AT_WALL, 0.2),
    ),
    "Bathroom": (
        ("Toilet", AT_WALL, 1.0),
        ("Sink", AT_WALL, 1.0),
        ("Bathtub", AT_WALL, 0.7),
        ("SideTable", AT_WALL, 0.4),
        ("GarbageCan", AT_WALL, 0.6),
        ("WashingMachine", AT_WALL, 0.3),
        ("LaundryHamper", AT_WALL, 0.3),
        ("HousePlant", AT_WALL, 0.2),
        ("Dresser", AT_WALL, 0.2),
        ("Footstool", AT_WALL, 0.2),
        ("ClothesDryer", AT_WALL, 0.1),
        ("SideTable", AT_WALL, 0.2),
        ("GarbageCan", AT_WALL, 0.1),
        ("HousePlant", AT_WALL, 0.1),
        ("Footstool", AT_WALL, 0.1),
        ("LaundryHamper", AT_WALL, 0.1),
    ),
}
MOST_SLOTS = len(_FURNITURE["Kitchen"])


def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns sizes, weights of receptacles, and by kind of room the slots and how often."""
    count = len(categories.NAMES)
    sizes = np.full((count, 3, 3), 0.3, np.float32)
    for name, size in {**SIZES, **_BOX_SIZES}.items():
        sizes[categories.index(name)] = size
    weights = np.zeros((count, count), np.float32)
    for name, receptacles in RECEPTACLES.items():
        for receptacle, share in receptacles.items():
            weights[categories.index(name), categories.index(receptacle)] = share
    slots = np.zeros((len(categories.ROOMS), MOST_SLOTS, 2), np.int32)
    shares = np.zeros((len(categories.ROOMS), MOST_SLOTS), np.float32)
    for name, furniture in _FURNITURE.items():
        kind = categories.ROOMS.index(name)
        slots[kind] = [(categories.index(name), where) for name, where, _ in furniture]
        shares[kind] = [share for _, _, share in furniture]
    return sizes, weights, slots, shares


_SIZES, _WEIGHTS, _SLOTS, _SHARES = _tables()
_TABLE = categories.index("DiningTable")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pieces:
    """Things that were placed, as rows of one table, which is quick to compile and to update.

    Attributes:
      rows: float32 [M, 19], the columns that the properties name.
    """

    rows: jax.Array

    @property
    def place(self) -> jax.Array:
        """Int32 [M], the wall it stands at, `OPEN`, at a `TABLE`, or `ABSENT`."""
        return self.rows[:, 0].astype(jnp.int32)

    @property
    def room(self) -> jax.Array:
        """Int32 [M], the row of its room; of things on furniture, the row of that."""
        return self.rows[:, 1].astype(jnp.int32)

    @property
    def category(self) -> jax.Array:
        """Int32 [M]."""
        return self.rows[:, 2].astype(jnp.int32)

    @property
    def turn(self) -> jax.Array:
        """Float32 [M, 2], the cosine and the sine of its yaw."""
        return self.rows[:, 3:5]

    @property
    def center(self) -> jax.Array:
        """Float32 [M, 3]."""
        return self.rows[:, 5:8]

    @property
    def half_size(self) -> jax.Array:
        """Float32 [M, 3]."""
        return self.rows[:, 8:11]

    @property
    def extent(self) -> jax.Array:
        """Float32 [M, 4], the rectangle (x low, z low, x high, z high) that it stands on."""
        return self.rows[:, 11:15]

    @property
    def kept(self) -> jax.Array:
        """Float32 [M, 4], the same with what belongs to it: the chairs at a table."""
        return self.rows[:, 15:19]


def _no_pieces(count: int) -> Pieces:
    """Returns `count` pieces that are absent."""
    return Pieces(jnp.zeros((count, 19), jnp.float32).at[:, 0].set(ABSENT))


def _put_first(
    pieces: Pieces,
    row: jax.Array,
    good: jax.Array,
    columns: tuple[jax.Array, ...],
) -> Pieces:
    """Puts the first good proposal into a row, which is absent if there is none.

    Args:
      pieces: to add to.
      row: int32 scalar.
      good: bool [K].
      columns: [K] or [K, n] each, in the order of `Pieces.rows`; or scalars.
    """
    count = len(good)
    table = jnp.concatenate(
        [
            jnp.broadcast_to(column, (count, *column.shape[1:])).reshape(count, -1)
            for column in (jnp.asarray(column, jnp.float32) for column in columns)
        ],
        axis=1,
    )
    first = good & (jnp.cumsum(good, dtype=jnp.int32) == 1)
    chosen = jnp.sum(jnp.where(first[:, None], table, 0.0), axis=0)
    chosen = chosen.at[0].add(jnp.where(jnp.any(good), 0.0, ABSENT))
    return Pieces(pieces.rows.at[row].set(chosen))


def _size(draws: jax.Array, category: jax.Array) -> jax.Array:
    """Turns uniform `draws` [3] into a size [3], half of the time below the median."""
    least, median, greatest = jnp.asarray(_SIZES)[category]
    below = least + (median - least) * 2 * draws
    above = median + (greatest - median) * (2 * draws - 1)
    return jnp.where(draws < 0.5, below, above)


def overlap(one: jax.Array, other: jax.Array, gap: jax.Array | float = 0.0) -> jax.Array:
    """Returns whether rectangles [..., 4] come closer to each other than `gap`, along both axes."""
    gap = jnp.asarray(gap, jnp.float32)
    apart_x = (one[..., 0] - gap >= other[..., 2]) | (other[..., 0] - gap >= one[..., 2])
    apart_z = (one[..., 1] - gap >= other[..., 3]) | (other[..., 1] - gap >= one[..., 3])
    return ~(apart_x | apart_z)


def _around(plan: jax.Array, half: jax.Array, turn: jax.Array) -> jax.Array:
    """Returns the rectangle [..., 4] about a turned one with centre and half size [..., 2]."""
    cosine, sine = jnp.abs(turn[..., 0]), jnp.abs(turn[..., 1])
    x = cosine * half[..., 0] + sine * half[..., 1]
    z = sine * half[..., 0] + cosine * half[..., 1]
    reach = jnp.stack([x, z], axis=-1)
    return jnp.concatenate([plan - reach, plan + reach], axis=-1)


def _offset(turn: jax.Array, local: jax.Array) -> jax.Array:
    """Turns a plan vector [..., 2] of a box's own frame into the house's."""
    cosine, sine = turn[..., 0], turn[..., 1]
    x, z = local[..., 0], local[..., 1]
    return jnp.stack([cosine * x + sine * z, cosine * z - sine * x], axis=-1)


def _side_gap(width: jax.Array) -> jax.Array:
    """Returns the metres to leave on either side of what stands at a wall, so wide each."""
    return jnp.maximum(_SIDE_GAP, (_STANDING_ROOM - width) / 2)


def _at_wall(
    draws: jax.Array, room: jax.Array, size: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Proposes places at walls.

    Args:
      draws: uniform float32 [K, 2].
      room: float32 [K, 4].
      size: float32 [3].

    Returns:
      Walls int32 [K], plans [K, 2], and whether there is room for it between the walls.
    """
    wall = jnp.minimum((draws[:, 0] * 4).astype(jnp.int32), 3)
    along_z = wall < 2
    margin, depth = _side_gap(size[0]) + size[0] / 2, size[2]
    low = jnp.where(along_z, room[:, 1], room[:, 0]) + margin
    high = jnp.where(along_z, room[:, 3], room[:, 2]) - margin
    along = low + draws[:, 1] * (high - low)
    # Either in the corner, or so far from it that one can stand there.
    niche = PASSAGE - _side_gap(size[0])
    along = jnp.where(high - along < niche, high, along)
    along = jnp.where(along - low < niche, low, along)
    at_low = (wall == 0) | (wall == 2)
    face = jnp.where(
        at_low,
        jnp.where(along_z, room[:, 0], room[:, 1]) + depth / 2,
        jnp.where(along_z, room[:, 2], room[:, 3]) - depth / 2,
    )
    plan = jnp.where(
        along_z[:, None], jnp.stack([face, along], axis=1), jnp.stack([along, face], axis=1)
    )
    across = jnp.where(along_z, room[:, 2] - room[:, 0], room[:, 3] - room[:, 1])
    fits = (high >= low + niche) & (across >= depth + PASSAGE)
    return wall, plan, fits


def _in_open(
    draws: jax.Array, room: jax.Array, half: jax.Array, is_table: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Proposes places in the open: turns [K, 2], plans [K, 2], and whether there is room for it.

    Args:
      draws: uniform float32 [K, 4].
      room: float32 [K, 4].
      half: float32 [2], half the width and depth, with chairs.
      is_table: bool scalar, whether chairs will stand at it; then it is parallel to the walls.
    """
    askew = jnp.deg2rad(jnp.where(is_table, 0.0, 30 * draws[:, 1] - 15))
    cosine, sine = jnp.cos(askew), jnp.sin(askew)
    turn = jnp.where(
        draws[:, :1] < 0.5,
        jnp.stack([cosine, sine], axis=1),
        jnp.stack([-sine, cosine], axis=1),
    )
    reach = _around(jnp.zeros((len(room), 2), jnp.float32), half, turn)
    low, high = room[:, :2] - reach[:, :2] + PASSAGE, room[:, 2:] - reach[:, 2:] - PASSAGE
    return turn, low + draws[:, 2:] * (high - low), jnp.all(high >= low, axis=1)


def _at_table(
    draws: jax.Array, pieces: Pieces, size: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Proposes places beside the table: turns [K, 2], plans [K, 2], and if there is one."""
    is_table = (pieces.category == _TABLE) & (pieces.place == OPEN)
    row = jnp.argmax(is_table)
    half, turn = pieces.half_size[row], pieces.turn[row]
    side = jnp.where(draws[:, 0] < 0.5, -1.0, 1.0)
    along = (2 * draws[:, 1] - 1) * jnp.maximum(half[0] - size[0] / 2, 0.0)
    local = jnp.stack([along, side * (half[2] + size[2] / 2 + 0.01)], axis=1)
    facing = -side[:, None] * turn
    fits = is_table[row] & (half[0] >= size[0] / 2)
    plan = pieces.center[row][jnp.array([0, 2], jnp.int32)] + _offset(turn, local)
    return facing, plan, jnp.broadcast_to(fits, along.shape)


def _place(
    size_draws: jax.Array,
    draws: jax.Array,
    pieces: Pieces,
    row: jax.Array,
    category: jax.Array,
    where: jax.Array,
    wanted: jax.Array,
    rooms: jax.Array,
    room_rows: jax.Array,
    clear: jax.Array,
) -> Pieces:
    """Puts a piece of furniture into one of several places, or nowhere if none will do.

    Args:
      size_draws: uniform float32 [3].
      draws: uniform float32 [K, 4].
      pieces: what there is.
      row: the row to put it in.
      category: int32 scalar.
      where: int32 scalar, `AT_WALL`, `IN_OPEN` or `AT_TABLE`.
      wanted: bool scalar.
      rooms: float32 [K, 4], the room of each proposal.
      room_rows: int32 [K].
      clear: float32 [D, 4], where nothing may stand.
    """
    size = _size(size_draws, category)
    is_table = category == _TABLE
    half = size[jnp.array([0, 2], jnp.int32)] / 2
    with_chairs = half + jnp.where(is_table, jnp.array([0, _CHAIR_DEPTH], jnp.float32), 0.0)

    wall, wall_plan, wall_fits = _at_wall(draws[:, :2], rooms, size)
    open_turn, open_plan, open_fits = _in_open(draws, rooms, with_chairs, is_table)
    table_turn, table_plan, table_fits = _at_table(draws[:, :2], pieces, size)
    at_wall, in_open = where == AT_WALL, where == IN_OPEN
    place = jnp.where(at_wall, wall, jnp.where(in_open, OPEN, TABLE))
    facing = jnp.where(in_open, open_turn, table_turn)
    turn = jnp.where(at_wall, jnp.asarray(_FROM_WALL)[wall], facing)
    plan = jnp.where(at_wall, wall_plan, jnp.where(in_open, open_plan, table_plan))
    fits = jnp.where(at_wall, wall_fits, jnp.where(in_open, open_fits, table_fits))

    extent = _around(plan, half, turn)
    kept = _around(plan, with_chairs, turn)
    same_wall = (pieces.place[None] == place[:, None]) & (place[:, None] < OPEN)
    beside = jnp.maximum(_side_gap(size[0]), _side_gap(2 * pieces.half_size[:, 0]))
    gap = jnp.where(same_wall, beside, PASSAGE)
    # Chairs at a table are within what it keeps: they mind only each other.
    of_table = pieces.place == TABLE
    crowded = overlap(kept[:, None], pieces.kept[None], gap) & ~of_table
    chairs = overlap(extent[:, None], pieces.extent[None], 0.02) & of_table
    near = jnp.where(place[:, None] == TABLE, chairs, crowded)
    near &= (pieces.place >= 0) & (pieces.room[None] == room_rows[:, None])
    in_doorway = jnp.any(overlap(kept[:, None], clear[None]) & (clear[:, 2] > clear[:, 0]), axis=1)
    in_doorway &= place != TABLE
    good = fits & wanted & ~jnp.any(near, axis=1) & ~in_doorway
    height = jnp.broadcast_to(size[1] / 2, len(plan))
    center = jnp.stack([plan[:, 0], height, plan[:, 1]], axis=1)
    sizes = jnp.broadcast_to(size / 2, center.shape)
    columns = (place, room_rows, category, turn, center, sizes, extent, kept)
    return _put_first(pieces, row, good, columns)


def shapes(rooms: int, slots: int, extras: int) -> tuple[Shape, ...]:
    """Returns the shapes of the random numbers that `furnish` takes."""
    in_rooms = ((rooms, slots), (rooms, slots, 3), (rooms, slots, _CANDIDATES, 4))
    return (*in_rooms, (extras, _CANDIDATES), (extras, 3), (extras, _CANDIDATES, 4))


def furnish(
    draws: Sequence[jax.Array], plan: FloorPlan, slots: int, extras: tuple[int, ...]
) -> Pieces:
    """Places furniture in every room, and then some things on the floor anywhere.

    Args:
      draws: uniform float32 of `shapes`.
      plan: the floor.
      slots: how many pieces a room has at most.
      extras: categories of things that are put on the floor at a wall of some room.

    Returns:
      Pieces [R · slots + len(extras)], room by room.
    """
    count = len(plan.rooms)
    in_rooms, anywhere = draws[:3], draws[3:]

    def furnish_room(row: jax.Array, in_room: tuple[jax.Array, ...]) -> Pieces:
        kind, room = plan.kind[row], plan.rooms[row]
        rooms = jnp.broadcast_to(room, (_CANDIDATES, 4))
        rows = jnp.broadcast_to(row, (_CANDIDATES,))
        there = room[2] > room[0]

        def add(pieces: Pieces, slot: tuple[jax.Array, ...]) -> tuple[Pieces, None]:
            i, chance, size, places = slot
            wanted = there & (chance < jnp.asarray(_SHARES)[kind, i])
            category, where = jnp.asarray(_SLOTS)[kind, i]
            return (
                _place(size, places, pieces, i, category, where, wanted, rooms, rows, plan.clear),
                None,
            )

        numbers = jnp.arange(slots, dtype=jnp.int32)
        return jax.lax.scan(add, _no_pieces(slots), (numbers, *in_room))[0]

    by_room = jax.vmap(furnish_room)(jnp.arange(count, dtype=jnp.int32), tuple(in_rooms))
    furniture = by_room.rows.reshape(count * slots, -1)
    pieces = Pieces(jnp.concatenate([furniture, _no_pieces(len(extras)).rows]))
    used = plan.rooms[:, 2] > plan.rooms[:, 0]
    weights = jnp.where(used, 1.0, 0.0)

    def add_extra(pieces: Pieces, extra: tuple[jax.Array, ...]) -> tuple[Pieces, None]:
        row, category, choice, size, places = extra
        rows = _weighted(choice, weights)
        at_wall, wanted = jnp.int32(AT_WALL), jnp.bool_(True)
        rooms = plan.rooms[rows]
        pieces = _place(
            size, places, pieces, row, category, at_wall, wanted, rooms, rows, plan.clear
        )
        return pieces, None

    if not extras:
        return pieces
    rows = jnp.arange(len(extras), dtype=jnp.int32) + count * slots
    return jax.lax.scan(add_extra, pieces, (rows, jnp.array(extras, jnp.int32), *anywhere))[0]


def _weighted(draws: jax.Array, weights: jax.Array) -> jax.Array:
    """Turns uniform `draws` [K] into int32 rows [K] chosen by weight."""
    sums = jnp.cumsum(weights)
    rows = jnp.sum(sums[None] <= draws[:, None] * sums[-1], axis=1, dtype=jnp.int32)
    return jnp.minimum(rows, len(weights) - 1)


def shapes_on_furniture(objects: int) -> tuple[Shape, ...]:
    """Returns the shapes of the random numbers that `set_out` takes."""
    return ((objects, 3), (objects, _CANDIDATES, 3))


def set_out(draws: Sequence[jax.Array], furniture: Pieces, objects: tuple[int, ...]) -> Pieces:
    """Puts things onto furniture, near edges that one can come to.

    Args:
      draws: uniform float32 of `shapes_on_furniture`.
      furniture: of `furnish`.
      objects: the categories of the things; those without a place are absent.

    Returns:
      Pieces [len(objects)], whose `room` is the row of the furniture that they are on.
    """
    top = 2 * furniture.half_size[:, 1]
    usable = (furniture.place >= 0) & (furniture.place <= OPEN) & (top <= _HIGHEST_RECEPTACLE)

    def add(things: Pieces, thing: tuple[jax.Array, ...]) -> tuple[Pieces, None]:
        row, category, size_draws, draws = thing
        size = _size(size_draws, category)
        weights = jnp.asarray(_WEIGHTS)[category, furniture.category]
        in_sight = (top <= _EYE_LEVEL) | (size[1] >= _FLAT)
        # By the intercept theorem, for the middle of its upper half.
        rise, inward = top - _LOWEST_CAMERA, size[2] / 2 + _EDGE
        in_sight &= 0.75 * size[1] * WIDEST_BODY >= rise * inward
        weights = jnp.where(usable & in_sight, weights, 0.0)
        under = _weighted(draws[:, 0], weights)
        on = Pieces(furniture.rows[under])
        half = on.half_size
        in_open = on.place == OPEN
        # At the ends of what stands in the open, else at the front; there not so far to the side
        # that a deeper neighbour could be in the way.
        end = jnp.where(draws[:, 1] < 0.5, -1.0, 1.0)
        span = jnp.where(in_open, half[:, 2], half[:, 0])
        room_beside = jnp.where(in_open, span, span - 0.11)
        sideways = jnp.maximum(jnp.minimum(span - size[0] / 2, room_beside), 0.0)
        along = (2 * draws[:, 2] - 1) * sideways
        at_end = jnp.stack([end * (half[:, 0] - inward), along], axis=1)
        at_front = jnp.stack([along, half[:, 2] - inward], axis=1)
        local = jnp.where(in_open[:, None], at_end, at_front)
        # A quarter of a turn to face the end.
        quarter = end[:, None] * jnp.stack([-on.turn[:, 1], on.turn[:, 0]], axis=1)
        turn = jnp.where(in_open[:, None], quarter, on.turn)
        plan = on.center[:, ::2] + _offset(on.turn, local)
        length = jnp.where(in_open, half[:, 0], 2 * half[:, 2])
        fits = (2 * span >= size[0]) & (length >= size[2] + _EDGE)
        extent = _around(plan, size[::2] / 2, turn)
        same = (things.room[None] == under[:, None]) & (things.place >= 0)
        near = jnp.any(overlap(extent[:, None], things.extent[None], 0.02) & same, axis=1)
        good = fits & ~near & (weights[under] > 0)
        height = 2 * half[:, 1] + size[1] / 2
        center = jnp.stack([plan[:, 0], height, plan[:, 1]], axis=1)
        sizes = jnp.broadcast_to(size / 2, center.shape)
        columns = (on.place, under, category, turn, center, sizes, extent, extent)
        return _put_first(things, row, good, columns), None

    rows = jnp.arange(len(objects), dtype=jnp.int32)
    things = _no_pieces(len(objects))
    return jax.lax.scan(add, things, (rows, jnp.array(objects, jnp.int32), *draws))[0]
