"""Pictures of tiles, as MiniGrid draws them: NumPy, made at first use and kept.

A picture is drawn at three times its size, pixel centres being tested against shapes in the unit
square (y down), and averaged down. Source of the shapes and of the order of rounding: `Grid.
render_tile`, `WorldObj.render` and `minigrid.utils.rendering` of minigrid 3.2.0.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from envs_jax.minigrid import tiles

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

# The atlas's axes after the tile's code: nobody or an agent in one of four directions; highlighted
# or not.
NUM_AGENTS = 5
NUM_CODES = tiles.NUM_TYPES * tiles.NUM_COLORS

_SUBDIVISIONS = 3
_HIGHLIGHT = 0.30
_LINE = 0.031
_BLACK, _AGENT_RED, _LINE_GREY, _LAVA_ORANGE = (0, 0, 0), (255, 0, 0), (100,) * 3, (255, 128, 0)
# Indexed by MiniGrid's colour numbers: red, green, blue, purple, yellow, grey.
COLORS = np.array(
    [(255, 0, 0), (0, 255, 0), (0, 0, 255), (112, 39, 195), (255, 255, 0), (100, 100, 100)]
)


@lru_cache(maxsize=8)
def atlas(tile_size: int) -> Image:
    """Draws every tile in every circumstance.

    Args:
      tile_size: pixels of a tile's edge.

    Returns:
      uint8[NUM_CODES · NUM_AGENTS · 2, tile_size, tile_size, 3]; picture
      ((type · NUM_COLORS + colour) · NUM_AGENTS + agent) · 2 + highlighted, where agent is 0 for
      nobody and direction + 1 else. Not to be written to.
    """
    canvas = Canvas(tile_size * _SUBDIVISIONS)
    agents = [canvas.agent(direction) for direction in range(4)]
    pictures = []
    for kind in range(tiles.NUM_TYPES):
        for color in range(tiles.NUM_COLORS):
            tile = _draw(canvas, kind, COLORS[color])
            for agent in (None, *agents):
                image = tile.copy()
                if agent is not None:
                    image[agent] = _AGENT_RED
                pictures += [_shrink(image), _shrink(_highlight(image))]
    result = np.stack(pictures)
    result.setflags(write=False)
    return result


class Canvas:
    """Masks bool[size, size] of the pixels whose centres lie in a shape."""

    def __init__(self, size: int) -> None:
        centers = (np.arange(size) + 0.5) / size
        self.x, self.y = np.meshgrid(centers, centers)

    def rectangle(self, left: float, right: float, top: float, bottom: float) -> Mask:
        """An upright rectangle, its edges included."""
        return (self.x >= left) & (self.x <= right) & (self.y >= top) & (self.y <= bottom)

    def circle(self, x: float, y: float, radius: float) -> Mask:
        """A disk, its edge included."""
        dx, dy = self.x - x, self.y - y
        return dx * dx + dy * dy <= radius * radius

    def segment(self, x0: float, y0: float, x1: float, y1: float, radius: float) -> Mask:
        """A thick line, cut off square at its bounding box."""
        # MiniGrid keeps the end points in single precision and the pixels in double.
        start, end = np.array([x0, y0], np.float32), np.array([x1, y1], np.float32)
        length = np.linalg.norm(end - start)
        unit = (end - start) / length
        dx, dy = self.x - start[0], self.y - start[1]
        along = np.clip(dx * unit[0] + dy * unit[1], 0, length)
        away = np.hypot(
            self.x - (start[0] + along * unit[0]), self.y - (start[1] + along * unit[1])
        )
        box = self.rectangle(
            min(x0, x1) - radius, max(x0, x1) + radius, min(y0, y1) - radius, max(y0, y1) + radius
        )
        return box & (away <= radius)

    def agent(self, direction: int) -> Mask:
        """The agent's triangle, pointing in `direction`."""
        angle = -0.5 * math.pi * direction
        dx, dy = self.x - 0.5, self.y - 0.5
        x = 0.5 + dx * math.cos(angle) - dy * math.sin(angle)
        y = 0.5 + dy * math.cos(angle) + dx * math.sin(angle)
        a, b, c = np.array([(0.12, 0.19), (0.87, 0.50), (0.12, 0.81)], np.float32)
        to_c, to_b = c - a, b - a
        cc, cb, bb = np.dot(to_c, to_c), np.dot(to_c, to_b), np.dot(to_b, to_b)
        px, py = x - a[0], y - a[1]
        pc, pb = to_c[0] * px + to_c[1] * py, to_b[0] * px + to_b[1] * py
        scale = 1 / (cc * bb - cb * cb)
        u, v = (bb * pc - cb * pb) * scale, (cc * pb - cb * pc) * scale
        return (u >= 0) & (v >= 0) & (u + v < 1)


def _draw(canvas: Canvas, kind: int, color: np.ndarray) -> Image:
    """Draws one tile at full resolution: the grid's lines, and what stands on it."""
    image = np.zeros((*canvas.x.shape, 3), np.uint8)
    image[canvas.rectangle(0, _LINE, 0, 1) | canvas.rectangle(0, 1, 0, _LINE)] = _LINE_GREY
    for mask, paint in _shapes(canvas, kind, color):
        image[mask] = np.asarray(paint).astype(np.uint8)
    return image


def _shapes(canvas: Canvas, kind: int, color: np.ndarray) -> list[tuple[Mask, object]]:
    """Returns the shapes of a tile and their paint, in the order they are painted over another."""
    rectangle, circle = canvas.rectangle, canvas.circle
    if kind in (tiles.WALL, tiles.GOAL):
        return [(rectangle(0, 1, 0, 1), color)]
    if kind == tiles.FLOOR:
        return [(rectangle(_LINE, 1, _LINE, 1), color / 2)]
    if kind == tiles.LAVA:
        return [(rectangle(0, 1, 0, 1), _LAVA_ORANGE), (_waves(canvas), _BLACK)]
    if kind == tiles.KEY:
        return [
            (rectangle(0.50, 0.63, 0.31, 0.88), color),
            (rectangle(0.38, 0.50, 0.59, 0.66), color),
            (rectangle(0.38, 0.50, 0.81, 0.88), color),
            (circle(0.56, 0.28, 0.190), color),
            (circle(0.56, 0.28, 0.064), _BLACK),
        ]
    if kind == tiles.BALL:
        return [(circle(0.5, 0.5, 0.31), color)]
    if kind == tiles.BOX:
        return [
            (rectangle(0.12, 0.88, 0.12, 0.88), color),
            (rectangle(0.18, 0.82, 0.18, 0.82), _BLACK),
            (rectangle(0.16, 0.84, 0.47, 0.53), color),
        ]
    return _door(canvas, kind, color)


def _door(canvas: Canvas, kind: int, color: np.ndarray) -> list[tuple[Mask, object]]:
    """Returns the shapes of a door, none for tiles that are no door."""
    rectangle = canvas.rectangle
    if kind in (tiles.OPEN_DOOR, tiles.OPEN_LOCKED_DOOR):
        return [
            (rectangle(0.88, 1.00, 0.00, 1.00), color),
            (rectangle(0.92, 0.96, 0.04, 0.96), _BLACK),
        ]
    if kind == tiles.LOCKED_DOOR:
        return [
            (rectangle(0.00, 1.00, 0.00, 1.00), color),
            (rectangle(0.06, 0.94, 0.06, 0.94), 0.45 * color),
            (rectangle(0.52, 0.75, 0.50, 0.56), color),
        ]
    if kind == tiles.CLOSED_DOOR:
        return [
            (rectangle(0.00, 1.00, 0.00, 1.00), color),
            (rectangle(0.04, 0.96, 0.04, 0.96), _BLACK),
            (rectangle(0.08, 0.92, 0.08, 0.92), color),
            (rectangle(0.12, 0.88, 0.12, 0.88), _BLACK),
            (canvas.circle(0.75, 0.50, 0.08), color),
        ]
    return []


def _waves(canvas: Canvas) -> Mask:
    """Three zigzag lines, each of four strokes."""
    mask = np.zeros(canvas.x.shape, bool)
    for wave in range(3):
        crest, trough = 0.3 + 0.2 * wave, 0.4 + 0.2 * wave
        for x0, x1, y0, y1 in [
            (0.1, 0.3, crest, trough),
            (0.3, 0.5, trough, crest),
            (0.5, 0.7, crest, trough),
            (0.7, 0.9, trough, crest),
        ]:
            mask |= canvas.segment(x0, y0, x1, y1, 0.03)
    return mask


def _highlight(image: Image) -> Image:
    return (image + _HIGHLIGHT * (255 - image)).astype(np.uint8)


def _shrink(image: Image) -> Image:
    """Averages blocks of pixels, first along rows: another order would round differently."""
    size = len(image) // _SUBDIVISIONS
    blocks = image.reshape(size, _SUBDIVISIONS, size, _SUBDIVISIONS, 3)
    return blocks.mean(axis=3).mean(axis=1).astype(np.uint8)
