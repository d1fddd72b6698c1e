"""Houses in ProcTHOR's JSON, schema 1.0.0: walls with holes, doors, windows, things in things."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.asset_sizes import SIZES
from envs_jax.houses.generator import COLORS
from envs_jax.houses.importers.reading import field, optional, read_json, vector
from envs_jax.houses.scene import Scene, make_scene
from jaxact.errors import JaxactError, unknown

_THICK = 0.1
_RELIEF = 0.01
# By how much holes may stick out of their walls.
_SLACK = 0.01
# The type and the size (x, y, z) of each asset.
Assets = Mapping[str, tuple[str, tuple[float, float, float]]]
_Source = str | Path
_Box = tuple[float, float, float, float, float, float, float]


@dataclasses.dataclass(frozen=True)
class _Wall:
    """The line of a wall on the floor, from which its holes are measured, and its height."""

    start: tuple[float, float]
    end: tuple[float, float]
    height: float

    @property
    def length(self) -> float:
        return math.dist(self.start, self.end)

    def box(self, begin: float, end: float, low: float, high: float, thick: float) -> _Box:
        """Returns a stretch of it as a box: centre, size, yaw."""
        x, z = (b - a for a, b in zip(self.start, self.end, strict=True))
        share = (begin + end) / 2 / self.length
        center = (self.start[0] + share * x, (low + high) / 2, self.start[1] + share * z)
        yaw = math.degrees(math.atan2(-z, x))
        return (*center, end - begin, high - low, thick, yaw)


@dataclasses.dataclass(frozen=True)
class _Part:
    """A box, its category, and where it goes when it is opened."""

    box: _Box
    category: str
    open_box: _Box | None = None


def read_assets(path: _Source) -> Assets:
    """Reads ProcTHOR's asset database: object types, each with a list of assets.

    Raises:
      JaxactError: the file is no such database.
    """
    database = read_json(path)
    if not isinstance(database, dict):
        raise JaxactError(f"{path} must be an object of lists of assets by type")
    assets = {}
    for kind in database:
        for i, entry in enumerate(field(path, "the database", database, kind, list)):
            where = f"asset {i} of {kind}"
            name = field(path, where, entry, "assetId", str)
            size = vector(path, where, field(path, where, entry, "boundingBox", dict))
            if min(size) < 0:
                raise JaxactError(f"{path}: 'boundingBox' of {where} must not be negative")
            assets[name] = (kind, (size[0], size[1], size[2]))
    return assets


def read_house(path: _Source, assets: Assets | None = None, boxes: int | None = None) -> Scene:
    """Reads a house.

    The two faces of a wall become one box 0.1 m thick, cut open where there are doors. Doors that
    lead outside are shut for good; others that are shut can be opened. An asset that is not in
    `assets` has the median size of the type that its object's id names.

    Args:
      path: the house, JSON of schema 1.0.0, compressed or not.
      assets: of `read_assets`; None for none.
      boxes: how many rows the scene is to have; None for as many as there are.

    Raises:
      JaxactError: the file is no such house, a type is unknown, or there are more boxes.
    """
    house = read_json(path)
    metadata = field(path, "the house", house, "metadata", dict)
    schema = field(path, "the metadata", metadata, "schema", str)
    if schema != "1.0.0":
        raise JaxactError(f"{path}: schema {schema!r} is not supported, only '1.0.0'")
    walls = _read_walls(path, house)
    doors = _openings(path, house, "doors", walls)
    parts = [_Part(box, "Wall") for box in _cut(walls, [(wall, hole) for wall, hole, _ in doors])]
    for wall, hole, record in doors:
        parts += _door(wall, hole, record)
    for wall, hole, _ in _openings(path, house, "windows", walls):
        begin, end, low, high = hole
        parts.append(_Part(wall.box(begin, end, low, high, _THICK + 2 * _RELIEF), "Window"))
    for i, record in enumerate(field(path, "the house", house, "objects", list)):
        parts += _things(path, f"object {i}", record, assets or {})
    if boxes is not None and len(parts) > boxes:
        raise JaxactError(f"{path} has {len(parts)} boxes, more than {boxes}")
    rooms = list(_read_rooms(path, house))
    if not rooms:
        raise JaxactError(f"{path}: a house needs rooms")
    scene = make_scene(
        [part.box for part in parts],
        [categories.index(part.category) for part in parts],
        [rectangle for rectangle, _ in rooms],
        size=boxes,
        other_boxes=[part.open_box for part in parts],
    )
    kinds = np.asarray(scene.category)
    portable = [name in SIZES and max(SIZES[name][1]) < 0.5 for name in categories.NAMES]
    return dataclasses.replace(
        scene,
        room_kind=jnp.array([kind for _, kind in rooms], jnp.int32),
        ceiling=jnp.float32(max(wall.height for wall in walls.values())),
        color=jnp.asarray(COLORS[kinds] * (kinds > 0)[:, None]),
        portable=jnp.asarray(np.array(portable)[kinds]),
    )


def _read_walls(path: _Source, house: Any) -> dict[str, _Wall]:
    """Returns the walls by id, both faces of each."""
    walls = {}
    for i, record in enumerate(field(path, "the house", house, "walls", list)):
        where = f"wall {i}"
        name = field(path, where, record, "id", str)
        points = [vector(path, where, p) for p in field(path, where, record, "polygon", list)]
        floor = min((point[1] for point in points), default=0.0)
        base = [(x, z) for x, y, z in points if y == floor]
        if len(points) != 4 or len(base) != 2 or math.dist(*base) < 1e-6:
            raise JaxactError(f"{path}: {where} must be an upright rectangle of four points")
        if name in walls:
            raise JaxactError(f"{path}: {where} has the id {name!r} of another wall")
        walls[name] = _Wall(base[0], base[1], max(point[1] for point in points) - floor)
    if not walls:
        raise JaxactError(f"{path}: a house needs walls")
    return walls


def _openings(
    path: _Source, house: Any, kind: str, walls: Mapping[str, _Wall]
) -> list[tuple[_Wall, tuple[float, float, float, float], Mapping]]:
    """Returns the holes of doors or windows: the wall, (begin, end, low, high), and the record."""
    found = []
    # Stages of generation before there are any say null.
    for i, record in enumerate(optional(path, "the house", house, kind, list, [])):
        where = f"{kind[:-1]} {i}"
        name = field(path, where, record, "wall0", str)
        if name not in walls:
            raise JaxactError(f"{path}: {where} is in {name!r}, which is no wall of the house")
        polygon = field(path, where, record, "holePolygon", list)
        corners = [vector(path, where, point, "xy") for point in polygon]
        if len(corners) < 2:
            raise JaxactError(f"{path}: the hole of {where} must have two corners")
        begin, low = (min(values) for values in zip(*corners, strict=True))
        end, high = (max(values) for values in zip(*corners, strict=True))
        length, height = walls[name].length, walls[name].height
        if end - begin < _SLACK or begin < -_SLACK or end > length + _SLACK:
            raise JaxactError(
                f"{path}: the hole of {where} is from {begin:g} to {end:g} m along {name!r}, which "
                f"is {length:g} m long"
            )
        if high - low < _SLACK or low < -_SLACK or high > height + _SLACK:
            raise JaxactError(
                f"{path}: the hole of {where} is from {low:g} to {high:g} m up {name!r}, which is "
                f"{height:g} m high"
            )
        found.append((walls[name], (begin, end, low, high), record))
    return found


def _cut(
    walls: Mapping[str, _Wall], holes: list[tuple[_Wall, tuple[float, float, float, float]]]
) -> Iterator[_Box]:
    """Yields what is left of the walls: between the holes, below and above them."""

    def line(wall: _Wall) -> frozenset:
        # Both faces of a wall are the same line, one way or the other.
        return frozenset((round(x, 2), round(z, 2)) for x, z in (wall.start, wall.end))

    faces = {line(wall): wall for wall in walls.values()}
    # Holes are measured from the start of the face that they are given in.
    faces |= {line(wall): wall for wall, _ in holes}
    for key, wall in faces.items():
        # The ends fill the corners.
        done = -_THICK / 2
        ends = wall.length + _THICK / 2
        own = []
        for face, (begin, end, low, high) in holes:
            if line(face) == key:
                turned = (begin, end) if face == wall else (wall.length - end, wall.length - begin)
                own.append((*turned, low, high))
        for begin, end, low, high in sorted(own):
            # Holes may touch or overlap.
            if begin > done:
                yield wall.box(done, begin, 0.0, wall.height, _THICK)
            if low > 0:
                yield wall.box(begin, end, 0.0, low, _THICK)
            if high < wall.height:
                yield wall.box(begin, end, high, wall.height, _THICK)
            done = max(done, end)
        yield wall.box(done, ends, 0.0, wall.height, _THICK)


def _door(wall: _Wall, hole: tuple[float, float, float, float], record: Mapping) -> Iterator[_Part]:
    """Yields the leaf of a door that is shut."""
    begin, end, low, high = hole
    outside = record.get("room0") == record.get("room1")
    shut = wall.box(begin, end, low, high, _THICK / 2)
    if outside:
        yield _Part(shut, "Door")
    elif record.get("openable") and not record.get("openness"):
        # It swings about the hole's end.
        share = end / wall.length
        hinge = [a + share * (b - a) for a, b in zip(wall.start, wall.end, strict=True)]
        turned, width = math.radians(shut[6] + 90), end - begin
        x, z = hinge[0] - math.cos(turned) * width / 2, hinge[1] + math.sin(turned) * width / 2
        yield _Part(shut, "Door", (x, shut[1], z, width, high - low, _THICK / 2, shut[6] + 90))


def _things(path: _Source, where: str, record: Any, assets: Assets) -> Iterator[_Part]:
    """Yields an object and all that is in it."""
    name = field(path, where, record, "id", str)
    where = f"{where} ({name})"
    asset = field(path, where, record, "assetId", str)
    if asset in assets:
        kind, size = assets[asset]
        if kind not in categories.NAMES:
            raise JaxactError(f"{path}: {where}: {unknown('object type', kind, categories.NAMES)}")
    else:
        kind = re.split(r"[|_]", name)[0]
        if kind not in SIZES:
            raise JaxactError(f"{path}: unknown asset {asset!r}, and {name!r} names no object type")
        width, height, depth = SIZES[kind][1]
        size = (width, height, depth)
    x, y, z = vector(path, where, field(path, where, record, "position", dict))
    yaw = vector(path, where, field(path, where, record, "rotation", dict))[1]
    yield _Part((x, y, z, *size, yaw), kind)
    for i, child in enumerate(optional(path, where, record, "children", list, [])):
        yield from _things(path, f"child {i} of {where}", child, assets)


def _read_rooms(
    path: _Source, house: Any
) -> Iterator[tuple[tuple[float, float, float, float], int]]:
    """Yields rectangles that make up the rooms, and the kind of each."""
    for i, record in enumerate(field(path, "the house", house, "rooms", list)):
        where = f"room {i}"
        polygon = field(path, where, record, "floorPolygon", list)
        corners = [vector(path, where, point, "xz") for point in polygon]
        name = field(path, where, record, "roomType", str)
        kind = categories.ROOMS.index(name) if name in categories.ROOMS else 0
        edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
        if len(corners) < 4:
            raise JaxactError(f"{path}: {where} must have at least four corners")
        if any(min(abs(a[0] - b[0]), abs(a[1] - b[1])) > 1e-3 for a, b in edges):
            raise JaxactError(f"{path}: the walls of {where} must be parallel to the axes")
        sides = sorted({x for x, _ in corners})
        for low, high in itertools.pairwise(sides):
            middle = (low + high) / 2
            # The edges along x that a line through the slab crosses bound it, by pairs.
            crossed = sorted(a[1] for a, b in edges if min(a[0], b[0]) < middle < max(a[0], b[0]))
            for z_low, z_high in zip(crossed[::2], crossed[1::2], strict=True):
                yield (low, z_low, high, z_high), kind
