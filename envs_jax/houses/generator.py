"""Furnished houses at random: a pure function of a key, of fixed shapes and bounded work.

What there is and how large follows the statistics of ProcTHOR's assets (`asset_sizes`); floor plans
are in `floor_plans`, why one can go everywhere in them in `furnishing`, and what opens in
`openings`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories, floor_plans, furnishing, openings
from envs_jax.houses.draws import draw
from envs_jax.houses.floor_plans import MOST_ROOMS, FloorPlan
from envs_jax.houses.furnishing import MOST_SLOTS, Pieces
from envs_jax.houses.openings import Openings
from envs_jax.houses.scene import PADDING, Scene
from jaxact.errors import JaxactError, unknown

SPLITS = ("train", "val", "test")
_ON_FLOOR = ("GarbageCan", "HousePlant", "BasketBall", "BaseballBat")
_ON_FURNITURE = tuple(name for name in categories.ROBOTHOR_TARGETS if name not in _ON_FLOOR)
# Of what stands on the floor; all that lies on furniture can be carried but televisions.
_PORTABLE = np.array([name in ("BasketBall", "BaseballBat", "Box") for name in categories.NAMES])


@dataclass(frozen=True)
class Style:
    """What houses are like.

    Attributes:
      long_side: least and greatest length in metres of the longer side, between the middles of the
        outer walls.
      short_side: of the shorter one; at least 2.3.
      rooms: least and greatest number of rooms; fewer where they would become too small.
      widest_door: the greatest width of a doorway; the least is 0.9.
      lintels: whether there is wall above doorways.
      furniture: how many pieces stand in a room at most.
      on_floor: names of what is put on the floor somewhere.
      on_furniture: names of what is put on furniture, each where ProcTHOR's statistics would have
        it; absent if there is no such furniture.
      fronts: how many doors and drawers of furniture there are at most, see `openings`.
      kept: names of what is kept in a fridge that opens; absent if there is none.
      kind: the kind of the only room; empty for any, and with several rooms by their size.
      boxes: rows of the scene.
    """

    numbers_are_structure: ClassVar[bool] = True

    long_side: tuple[float, float]
    short_side: tuple[float, float]
    rooms: tuple[int, int]
    widest_door: float
    lintels: bool
    furniture: int
    on_floor: tuple[str, ...]
    on_furniture: tuple[str, ...]
    fronts: int = 0
    kept: tuple[str, ...] = ()
    kind: str = ""
    boxes: int = 64

    def __post_init__(self) -> None:
        if not 1 <= self.rooms[0] <= self.rooms[1] <= MOST_ROOMS:
            raise JaxactError(f"rooms must be two numbers in 1 … {MOST_ROOMS}, not {self.rooms}")
        if self.kind and self.kind not in categories.ROOMS[1:]:
            raise unknown("kind of room", self.kind, categories.ROOMS[1:])
        if not 0 <= self.furniture <= MOST_SLOTS:
            raise JaxactError(f"furniture must be in 0 … {MOST_SLOTS}, not {self.furniture}")
        if min(self.short_side) < 2.3 or self.widest_door < 0.9:
            raise JaxactError("sides must be at least 2.3 m, and widest_door at least 0.9 m")
        rooms, walls = self.rooms[1], 3 if self.lintels else 2
        needed = 4 + walls * (rooms - 1) + 1 + rooms + rooms * self.furniture
        needed += len(self.on_floor) + len(self.on_furniture) + self.fronts + len(self.kept)
        if needed > self.boxes:
            raise JaxactError(f"such houses need {needed} boxes, not {self.boxes}")
        if self.kept and not self.fronts:
            raise JaxactError("what is kept needs a fridge that opens: fronts must be at least 1")
        for name in self.on_floor + self.on_furniture + self.kept:
            categories.index(name)


# A single room, as iTHOR's kitchens, living rooms, bedrooms and bathrooms.
ROOM = Style(
    long_side=(3.6, 7.0),
    short_side=(3.0, 5.0),
    rooms=(1, 1),
    widest_door=0.9,
    lintels=False,
    furniture=MOST_SLOTS,
    on_floor=_ON_FLOOR,
    on_furniture=(
        *_ON_FURNITURE,
        *("Book", "Box", "Bread", "Candle", "CellPhone", "CoffeeMachine", "Cup", "HousePlant"),
        *("Microwave", "Pan", "Pillow", "Plate", "Pot", "RemoteControl", "Statue", "TeddyBear"),
        *("Toaster", "Tomato"),
    ),
    fronts=8,
    kept=("Lettuce", "Egg"),
)
# A flat with thin partitions with gaps in them, as RoboTHOR's.
APARTMENT = Style(
    long_side=(7.5, 9.5),
    short_side=(4.0, 5.0),
    rooms=(3, 4),
    widest_door=1.6,
    lintels=False,
    furniture=8,
    on_floor=_ON_FLOOR,
    on_furniture=(*_ON_FURNITURE, "Book"),
    fronts=3,
    kept=("Lettuce",),
)
# A floor of several rooms with doorways, as ProcTHOR's houses and Habitat's scans.
FLOOR = Style(
    long_side=(7.0, 13.0),
    short_side=(5.0, 10.0),
    rooms=(3, 8),
    widest_door=1.2,
    lintels=True,
    furniture=8,
    on_floor=(*_ON_FLOOR, "Box"),
    on_furniture=(
        *_ON_FURNITURE,
        *("Book", "Book", "Bread", "Candle", "CellPhone", "Cup", "Microwave", "Pillow", "Plate"),
        *("Pot", "RemoteControl", "Statue", "TeddyBear", "Toaster"),
    ),
    fronts=2,
    kept=("Lettuce",),
    boxes=128,
)


def scene_key(split: str, index: jax.Array | int) -> jax.Array:
    """Returns the key of a split's scene; no two splits share one.

    Raises:
      JaxactError: there is no such split.
    """
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)
    # The implementation is named so that scenes do not depend on JAX's settings.
    base = jax.random.fold_in(
        jax.random.key(0, impl="threefry2x32"), jnp.uint32(SPLITS.index(split))
    )
    return jax.random.fold_in(base, index)


def _colors() -> np.ndarray:
    """Returns a colour for each category, float32 [C, 3]: spread hues, vivid for small things."""
    number = np.arange(len(categories.NAMES))
    hue = 6 * (number * 0.618034 % 1)
    vivid = np.where([name in categories.FURNITURE for name in categories.NAMES], 0.4, 0.75)
    value = 0.9 - 0.45 * (number * 0.754878 % 1)
    # The usual way from hue, saturation and value to RGB.
    ramp = np.abs((hue[:, None] + np.array([0, 4, 2])) % 6 - 3) - 1
    rgb = value[:, None] * (1 - vivid[:, None] * (1 - np.clip(ramp, 0, 1)))
    fixed = {"Wall": (0.9, 0.88, 0.84), "Door": (0.5, 0.35, 0.22), "Window": (0.6, 0.78, 0.92)}
    for name, color in fixed.items():
        rgb[categories.index(name)] = color
    return rgb.astype(np.float32)


COLORS = _colors()


def generate(key: jax.Array, style: Style) -> Scene:
    """Draws a house.

    A body of up to 0.2 m radius can come from everywhere to everywhere and to within 1 m of all
    that can be carried, with a free line of sight once fridges are open. Everything is shut.

    Args:
      key: a PRNG key; `scene_key` gives those of a split.
      style: what it is to be like; static.
    """
    least, most = style.rooms
    extras = tuple(categories.index(name) for name in style.on_floor)
    objects = tuple(categories.index(name) for name in style.on_furniture)
    parts = [
        ((5,),),
        floor_plans.shapes(most),
        furnishing.shapes(most, style.furniture, len(extras)),
        furnishing.shapes_on_furniture(len(objects)),
        openings.shapes(style.fronts, len(style.kept)),
        ((3,), (style.boxes, 3), (2, 3)),
    ]
    numbers = iter(draw(key, [shape for shapes in parts for shape in shapes]))
    (draws,), for_plan, for_furniture, for_things, for_openings, for_colors = (
        [next(numbers) for _ in shapes] for shapes in parts
    )
    size = jnp.stack(
        [
            low + number * (high - low)
            for number, (low, high) in zip(draws, (style.long_side, style.short_side), strict=False)
        ]
    )
    size = jnp.where(draws[2] < 0.5, size, size[::-1])
    rooms = least + jnp.floor(draws[3] * (most - least + 1)).astype(jnp.int32)
    plan = floor_plans.draw_plan(for_plan, size, rooms, most, style.widest_door, style.lintels)
    if most == 1:
        drawn = 1 + jnp.floor(draws[4] * (len(categories.ROOMS) - 1)).astype(jnp.int32)
        kind = jnp.int32(categories.ROOMS.index(style.kind)) if style.kind else drawn
        plan = replace(plan, kind=kind[None])
    furniture = furnishing.furnish(for_furniture, plan, style.furniture, extras)
    things = furnishing.set_out(for_things, furniture, objects)
    kept = tuple(categories.index(name) for name in style.kept)
    furniture, opens = openings.add_openings(for_openings, furniture, style.fronts, kept)
    return _scene(for_colors, style, plan, furniture, things, opens)


def _scene(
    draws: list[jax.Array],
    style: Style,
    plan: FloorPlan,
    furniture: Pieces,
    things: Pieces,
    opens: Openings,
) -> Scene:
    """Puts everything into one table of boxes."""
    low, high = plan.structure[:, :3], plan.structure[:, 3:]
    center = jnp.concatenate([(low + high) / 2, furniture.center, things.center])
    half = jnp.concatenate([(high - low) / 2, furniture.half_size, things.half_size])
    unturned = jnp.broadcast_to(jnp.array([1, 0], jnp.float32), (len(low), 2))
    turn = jnp.concatenate([unturned, furniture.turn, things.turn])
    category = jnp.concatenate(
        [
            *(plan.category, furniture.category, things.category),
            *(opens.kept_category, opens.category),
        ]
    )
    placed = jnp.concatenate(
        [
            *(plan.category, furniture.place + 1, things.place + 1),
            *(opens.kept_category, opens.category),
        ]
    )
    placed = placed > 0
    number = jnp.arange(len(placed), dtype=jnp.int32)
    fronts = number >= len(placed) - style.fronts
    lies = (number >= len(low) + len(furniture.place)) & ~fronts
    category = jnp.where(placed, category, 0)
    portable = jnp.where(
        lies, category != categories.index("Television"), jnp.asarray(_PORTABLE)[category]
    )
    stays = jnp.concatenate([jnp.concatenate([center, half, turn], axis=1), opens.kept])
    missing = style.boxes - len(placed)
    padding = jnp.array(PADDING, jnp.float32)

    def table(rows: jax.Array) -> jax.Array:
        rows = jnp.where(placed[:, None], jnp.concatenate([stays, rows]), padding)
        return jnp.concatenate([rows, jnp.broadcast_to(padding, (missing, 8))])

    category = jnp.pad(category, (0, missing))
    portable = jnp.pad(portable & placed, (0, missing))

    wall_draws, own_draws, surface_draws = draws
    # The walls of a house are all of one colour, other things each a little off their category's.
    walls = 0.33 * wall_draws - 0.25
    own = 0.2 * own_draws - 0.1
    is_wall = (category == categories.index("Wall"))[:, None]
    color = jnp.asarray(COLORS)[category] + jnp.where(is_wall, walls, own)
    surface = jnp.array([[0.55, 0.42, 0.3], [0.95, 0.95, 0.93]], jnp.float32)
    tint = 2 * surface_draws - 1
    surface += jnp.array([[0.15], [0.05]], jnp.float32) * tint
    return Scene(
        boxes=table(opens.boxes),
        other_boxes=table(opens.other_boxes),
        category=category,
        color=jnp.where((category > 0)[:, None], jnp.clip(color, 0.0, 1.0), 0.0),
        openable=jnp.pad(fronts & placed, (0, missing)),
        portable=portable,
        opened=jnp.zeros(style.boxes, bool),
        rooms=plan.rooms,
        room_kind=plan.kind,
        ceiling=plan.ceiling,
        surface=jnp.clip(surface, 0.0, 1.0),
    )
