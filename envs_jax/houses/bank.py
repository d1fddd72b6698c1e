"""A number of houses that are made once and then drawn from, each with its roadmap."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import is_free, obstacles
from envs_jax.houses.draws import draw, first_true
from envs_jax.houses.generator import SPLITS, Style, generate, scene_key
from envs_jax.houses.geodesic import GoalField, Roadmap, build_roadmap, goal_field, shortest
from envs_jax.houses.scene import PADDING, Scene
from envs_jax.houses.state import Body
from jaxact.errors import JaxactError, unknown

CANDIDATES = 32
# How many of the candidates that are free may become the middle of a house.
_MIDDLES = 8


class Scenes(ABC):
    """Where the houses come from; static and hashable."""

    @property
    @abstractmethod
    def held_out(self) -> Scenes:
        """The houses to evaluate in."""

    @property
    @abstractmethod
    def boxes(self) -> int:
        """N, rows of each scene."""

    @abstractmethod
    def load(self) -> Scene:
        """Returns all houses, a scene with a leading axis [S]."""


@dataclass(frozen=True)
class GeneratedScenes(Scenes):
    """The first houses of a split of the generator; the same wherever and whenever they are made.

    Attributes:
      style: what they are like.
      count: S.
      split: "train", "val" or "test"; what is held out of the first is the second.
      held_out_count: how many houses are held out.
    """

    style: Style
    count: int = 128
    split: str = "train"
    held_out_count: int = 32

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise unknown("split", self.split, SPLITS)
        if min(self.count, self.held_out_count) < 1:
            raise JaxactError("a bank of houses needs at least one")

    @property
    def held_out(self) -> GeneratedScenes:
        """Houses of "val" for those of "train"; the others are held out themselves."""
        if self.split != "train":
            return self
        return replace(self, split="val", count=self.held_out_count)

    @property
    def boxes(self) -> int:
        """As the style has it."""
        return self.style.boxes

    def load(self) -> Scene:
        """Draws all houses."""

        def draw(index: jax.Array) -> Scene:
            return generate(scene_key(self.split, index), self.style)

        return jax.vmap(draw)(jnp.arange(self.count, dtype=jnp.int32))


@dataclass(frozen=True, eq=False)
class ImportedScenes(Scenes):
    """Houses from elsewhere, for example from `importers`; equal only to itself.

    Attributes:
      scenes: with a leading axis [S], see `stack`.
      evaluation: the houses to evaluate in; None for the same.
    """

    scenes: Scene
    evaluation: ImportedScenes | None = None

    @property
    def held_out(self) -> ImportedScenes:
        """`evaluation`, if there is one."""
        return self if self.evaluation is None else self.evaluation

    @property
    def boxes(self) -> int:
        """As the scenes have it."""
        return int(self.scenes.boxes.shape[1])

    def load(self) -> Scene:
        """Returns `scenes`."""
        return self.scenes


def stack(scenes: Sequence[Scene]) -> Scene:
    """Stacks houses, padded to the same numbers of boxes and rooms.

    Raises:
      JaxactError: there are none.
    """
    if not scenes:
        raise JaxactError("a bank of houses needs at least one")
    boxes = max(scene.boxes.shape[0] for scene in scenes)
    rooms = max(scene.rooms.shape[0] for scene in scenes)

    def padded(scene: Scene) -> Scene:
        def rows(column: jax.Array) -> jax.Array:
            missing = boxes - scene.boxes.shape[0]
            return jnp.pad(column, [(0, missing)] + [(0, 0)] * (column.ndim - 1))

        extra = rooms - scene.rooms.shape[0]
        filled = jnp.arange(boxes) < scene.boxes.shape[0]
        nowhere = jnp.array(PADDING, jnp.float32)
        return replace(
            scene,
            boxes=jnp.where(filled[:, None], rows(scene.boxes), nowhere),
            other_boxes=jnp.where(filled[:, None], rows(scene.other_boxes), nowhere),
            category=rows(scene.category),
            color=rows(scene.color),
            openable=rows(scene.openable),
            portable=rows(scene.portable),
            opened=rows(scene.opened),
            rooms=jnp.pad(scene.rooms, ((0, extra), (0, 0))),
            room_kind=jnp.pad(scene.room_kind, (0, extra)),
        )

    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *[padded(scene) for scene in scenes])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bank:
    """Houses to draw from.

    Attributes:
      scenes: with a leading axis [S].
      roadmaps: likewise.
      middles: likewise, the ways to a place from which most of the house can be reached.
    """

    scenes: Scene
    roadmaps: Roadmap
    middles: GoalField

    @property
    def size(self) -> int:
        """S."""
        return self.scenes.boxes.shape[0]


def build_bank(scenes: Scenes, body: Body, nodes: int) -> Bank:
    """Makes the houses and their roadmaps.

    Args:
      scenes: where the houses come from.
      body: of who is to walk there.
      nodes: how many corners a roadmap has at most.
    """
    loaded = scenes.load()

    def survey(scene: Scene) -> tuple[Roadmap, GoalField]:
        roadmap = build_roadmap(scene, body, nodes)
        blocked = obstacles(scene.boxes, body)
        key = jax.random.key(0, impl="threefry2x32")
        (draws,) = draw(key, [(CANDIDATES, 3)])
        places, free = free_places(draws, scene, blocked, body.radius, 0.0)

        def reach(place: jax.Array) -> tuple[jax.Array, GoalField]:
            ways = goal_field(roadmap, blocked, body.radius, place[None])
            metres = jax.vmap(lambda other: shortest(ways, blocked, body.radius, other))(places)
            return jnp.sum((metres < jnp.inf) & free, dtype=jnp.int32), ways

        rows, there = first_true(free, _MIDDLES)
        counts, ways = jax.vmap(reach)(places[rows])
        best = jnp.argmax(jnp.where(there, counts, -1))
        return roadmap, jax.tree.map(lambda leaf: leaf[best], ways)

    # One after the other: the pairs of corners against all boxes are many.
    return Bank(loaded, *jax.lax.map(survey, loaded))


def free_places(
    draws: jax.Array, scene: Scene, blocked: jax.Array, radius: float, grid: float
) -> tuple[jax.Array, jax.Array]:
    """Draws places in rooms, each square metre as likely as any other.

    Args:
      draws: uniform float32 [K, 3].
      scene: the house.
      blocked: float32 [N, 8], its obstacles.
      radius: of the body.
      grid: metres, places are at multiples of it; 0 for anywhere.

    Returns:
      Plans float32 [K, 2] and bool [K], at which of them the body fits.
    """
    sides = scene.rooms[:, 2:] - scene.rooms[:, :2]
    ends = jnp.cumsum(sides[:, 0] * sides[:, 1])
    past = jnp.pad(ends[:-1] <= draws[:, :1] * ends[-1], ((0, 0), (1, 0)), constant_values=True)
    last = ~jnp.pad(past[:, 1:], ((0, 0), (0, 1)))
    # Not looked up by its row: a generator's rounds within an address take LLVM minutes.
    room = jnp.sum(jnp.where((past & last)[:, :, None], scene.rooms, 0.0), axis=1)
    places = room[:, :2] + draws[:, 1:] * (room[:, 2:] - room[:, :2])
    if grid > 0:
        places = jnp.round(places / grid) * grid
    inside = jnp.all((places >= room[:, :2]) & (places <= room[:, 2:]), axis=1)
    free = jax.vmap(lambda place: is_free(blocked, radius, place))(places)
    return places, free & inside
