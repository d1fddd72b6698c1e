"""Scenes as they are, in JSON of this library's own: what is read is what was written, bit by bit.

A file has houses by name. Of each it has the rows of `Scene` that are not padding: a category, the
centre, half size, cosine and sine of the yaw ("box"), where it goes when it is opened, an RGB
colour, and what can be done with it; and rooms, ceiling, and the colours of floor and ceiling.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.importers.reading import field, numbers, read_json
from envs_jax.houses.importers.writing import write_json
from envs_jax.houses.scene import PADDING, Scene
from jaxact.errors import JaxactError, unknown

FORMAT = "jaxact-scenes-1"
_MOST_ROWS = 100_000
_FLAGS = ("openable", "portable", "opened")


def write_scenes(path: str | Path, scenes: Mapping[str, Scene]) -> None:
    """Writes houses by name.

    Args:
      path: the file; compressed by gzip if its name ends in ".gz". It is written whole or not at
        all.
      scenes: without leading axes.

    Raises:
      JaxactError: the file cannot be written.
    """
    houses = {name: _to_json(scene) for name, scene in scenes.items()}
    write_json(path, {"format": FORMAT, "scenes": houses})


def read_scenes(path: str | Path) -> dict[str, Scene]:
    """Reads the houses of a file that `write_scenes` wrote, compressed or not.

    Raises:
      JaxactError: the file is no such file; the message says where.
    """
    data = read_json(path)
    found = field(path, "the file", data, "format", str)
    if found != FORMAT:
        raise JaxactError(f"{path}: format {found!r} is not supported, only {FORMAT!r}")
    houses = field(path, "the file", data, "scenes", dict)
    return {name: _from_json(path, f"scene {name!r}", house) for name, house in houses.items()}


def _to_json(scene: Scene) -> dict[str, Any]:
    columns = {name: np.asarray(getattr(scene, name)).tolist() for name in vars(scene)}
    rows = []
    for i in np.flatnonzero(np.asarray(scene.present)).tolist():
        record = {"row": i, "category": categories.NAMES[columns["category"][i]]}
        record["box"] = columns["boxes"][i]
        if columns["other_boxes"][i] != columns["boxes"][i]:
            record["other_box"] = columns["other_boxes"][i]
        record["color"] = columns["color"][i]
        record |= {flag: True for flag in _FLAGS if columns[flag][i]}
        rows.append(record)
    rooms = [
        {"kind": categories.ROOMS[kind], "rectangle": rectangle}
        for kind, rectangle in zip(columns["room_kind"], columns["rooms"], strict=True)
    ]
    floor, ceiling = columns["surface"]
    return {
        "rows": scene.boxes.shape[0],
        "boxes": rows,
        "rooms": rooms,
        "ceiling": columns["ceiling"],
        "floor_color": floor,
        "ceiling_color": ceiling,
    }


def _from_json(path: str | Path, where: str, record: Any) -> Scene:
    count = field(path, where, record, "rows", int)
    if not 0 < count <= _MOST_ROWS:
        raise JaxactError(
            f"{path}: 'rows' of {where} must be 1 … {_MOST_ROWS:,}, not {count!r:.20}"
        )
    boxes = np.tile(np.array(PADDING, np.float32), (count, 1))
    other_boxes, color = boxes.copy(), np.zeros((len(boxes), 3), np.float32)
    category = np.zeros(len(boxes), np.int32)
    flags = {name: np.zeros(len(boxes), bool) for name in _FLAGS}
    for i, box in enumerate(field(path, where, record, "boxes", list)):
        which = f"box {i} of {where}"
        row = field(path, which, box, "row", int)
        if not 0 <= row < len(boxes) or category[row]:
            raise JaxactError(
                f"{path}: 'row' of {which} must be one of 0 … {count - 1} that no other box has, "
                f"not {row}"
            )
        category[row] = _index(path, which, box, "category", categories.NAMES)
        boxes[row] = _box(path, which, box, "box")
        other_boxes[row] = _box(path, which, box, "other_box") if "other_box" in box else boxes[row]
        color[row] = numbers(path, which, box, "color", 3)
        for name in _FLAGS:
            flags[name][row] = name in box and field(path, which, box, name, bool)
    rooms = field(path, where, record, "rooms", list)
    if not rooms:
        raise JaxactError(f"{path}: {where} needs rooms")
    kinds = [
        _index(path, f"room {i} of {where}", room, "kind", categories.ROOMS)
        for i, room in enumerate(rooms)
    ]
    rectangles = [
        numbers(path, f"room {i} of {where}", room, "rectangle", 4) for i, room in enumerate(rooms)
    ]
    surface = [numbers(path, where, record, name, 3) for name in ("floor_color", "ceiling_color")]
    return Scene(
        boxes=jnp.asarray(boxes),
        other_boxes=jnp.asarray(other_boxes),
        category=jnp.asarray(category),
        color=jnp.asarray(color),
        rooms=jnp.array(rectangles, jnp.float32),
        room_kind=jnp.array(kinds, jnp.int32),
        ceiling=jnp.float32(field(path, where, record, "ceiling", float)),
        surface=jnp.array(surface, jnp.float32),
        **{name: jnp.asarray(column) for name, column in flags.items()},
    )


def _index(path: str | Path, where: str, record: Any, name: str, valid: tuple[str, ...]) -> int:
    value = field(path, where, record, name, str)
    if value not in valid:
        raise JaxactError(f"{path}: {where}: {unknown(name, value, valid)}")
    return valid.index(value)


def _box(path: str | Path, where: str, record: Any, name: str) -> list[float]:
    values = numbers(path, where, record, name, 8)
    if min(values[3:6]) < 0 or abs(values[6] ** 2 + values[7] ** 2 - 1) > 1e-3:
        raise JaxactError(
            f"{path}: {name!r} of {where} must be a centre, half sizes that are not negative, and "
            f"the cosine and sine of a yaw, not {values}"
        )
    return values
