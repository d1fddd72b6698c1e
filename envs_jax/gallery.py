"""A frame of every world, with its id and mission: `python -m envs_jax.gallery --help`.

Writes a sheet of frames for each family of ids, and a page that shows them.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import jax
import numpy as np
import tyro
from PIL import Image, ImageDraw, ImageFont
from rich.progress import track

import envs_jax
from envs_jax.minigrid.rendering import render
from envs_jax.minigrid.state import PADDING, GridState
from jaxact.errors import JaxactError, unknown

PROGRAM = "envs_jax.gallery"

# Pixels: what a frame must fit into, the largest tile, space round a cell and between lines.
_FRAME, _TILE, _MARGIN, _LINE = 192, 32, 10, 14
_MISSION_LINES = 3
_CELL = (_FRAME + 2 * _MARGIN, _FRAME + (1 + _MISSION_LINES) * _LINE + 3 * _MARGIN)
_BACKGROUND, _TEXT, _MUTED = (22, 24, 29), (232, 235, 240), (142, 150, 164)
# Beginnings of the ids of worlds of which nothing can be drawn.
_WITHOUT_PICTURES = ("Brax-", "Physics-")
# Each program runs once, so compiling it is nearly all of the work. To run without compiling takes
# several times longer still.
_COMPILE_QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
    "xla_llvm_disable_expensive_passes": True,
}


@dataclass(frozen=True)
class Arguments:
    """Draws the first frame of each world, with its id and mission: a PNG for each family of ids,
    and README.md to show them."""

    worlds: tyro.conf.Positional[tuple[str, ...]] = ()
    """Ids, or how they begin ("BabyAI-GoTo"); all by default."""
    seed: int = 0
    """Of the levels."""
    columns: int = 8
    """Frames side by side."""
    output: Path = Path("gallery")
    """Directory to write to."""


@dataclass(frozen=True)
class Exhibit:
    """What is shown of a world: its id, a frame uint8[H, W, 3] of a level, and the mission."""

    id: str
    frame: np.ndarray
    mission: str


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        for path in write(arguments):
            print(path)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)


def write(arguments: Arguments) -> list[Path]:
    """Writes the sheets and the page; returns their paths.

    Raises:
      JaxactError: no such world, or no column.
    """
    if arguments.columns < 1:
        raise JaxactError(f"--columns must be at least 1; got {arguments.columns}")
    names = select(arguments.worlds)
    take = functools.partial(exhibit, seed=arguments.seed)
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # XLA compiles outside of Python's lock.
        exhibits = list(track(pool.map(take, names), "drawing worlds", len(names)))
    families = {
        family: list(group) for family, group in groupby(exhibits, lambda x: x.id.split("-")[0])
    }
    arguments.output.mkdir(parents=True, exist_ok=True)
    paths = []
    for family, group in families.items():
        paths.append(arguments.output / f"{family.lower()}.png")
        sheet(group, arguments.columns).save(paths[-1], optimize=True)
    paths.append(arguments.output / "README.md")
    paths[-1].write_text(page(families, arguments.seed), encoding="utf-8")
    return paths


def select(beginnings: Sequence[str]) -> list[str]:
    """Returns the ids that begin in one of these ways, all if there are none, sorted.

    Raises:
      JaxactError: no id begins so.
    """
    names = [name for name in envs_jax.ids() if not name.startswith(_WITHOUT_PICTURES)]
    for beginning in beginnings:
        if not any(name.startswith(beginning) for name in names):
            raise unknown("environment id", beginning, names)
    return [name for name in names if name.startswith(tuple(beginnings) or "")]


def exhibit(name: str, seed: int) -> Exhibit:
    """Draws a world's level of a seed from above, of a grid world what the agent sees lighter."""
    pomdp = envs_jax.make(name)

    def begin(key: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        state, observation = pomdp.reset(key)
        world = state.environment
        if not isinstance(world, GridState):
            return next(iter(pomdp.pictures(state).values())), observation
        width, height = (edge - 2 * PADDING for edge in world.tiles.shape)
        return render(world, width, height, min(_TILE, _FRAME // max(width, height))), observation

    reset = jax.jit(begin, compiler_options=_COMPILE_QUICKLY)
    frame, observation = reset(jax.random.key(seed))
    return Exhibit(name, np.asarray(frame), pomdp.words(observation))


def sheet(exhibits: Sequence[Exhibit], columns: int) -> Image.Image:
    """Returns all frames on one sheet, `columns` of them side by side."""
    columns = min(columns, len(exhibits))
    rows = -(-len(exhibits) // columns)
    canvas = Image.new("RGB", (columns * _CELL[0], rows * _CELL[1]), _BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    for number, shown in enumerate(exhibits):
        left = number % columns * _CELL[0] + _MARGIN
        top = number // columns * _CELL[1] + _MARGIN
        frame = Image.fromarray(shown.frame)
        canvas.paste(frame, (left + (_FRAME - frame.width) // 2, top + _FRAME - frame.height))
        place = (left, top + _FRAME + _MARGIN // 2)
        draw.text(place, shown.id, _TEXT, _fitting_font(shown.id))
        for line, text in enumerate(_wrap(shown.mission), 1):
            place = (left, top + _FRAME + _MARGIN // 2 + line * _LINE)
            draw.text(place, text, _MUTED, _font(11))
    return canvas


def page(families: dict[str, list[Exhibit]], seed: int) -> str:
    """Returns the page in Markdown: for each family its sheet, and its ids with their missions."""
    lines = ["# Worlds", "", f"Made by `python -m {PROGRAM} --seed {seed}`."]
    for family, exhibits in families.items():
        lines += ["", f"## {family}", "", f"![{family}]({family.lower()}.png)", ""]
        lines += ["| id | mission |", "|---|---|"]
        lines += [f"| `{shown.id}` | {shown.mission} |" for shown in exhibits]
    return "\n".join(lines) + "\n"


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _fitting_font(text: str) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Returns the font for a line, smaller than others if it would not fit."""
    sizes = (11, 10, 9, 8)
    fonts = [_font(size) for size in sizes if _font(size).getlength(text) <= _FRAME]
    return fonts[0] if fonts else _font(sizes[-1])


def _wrap(text: str) -> list[str]:
    """Breaks a text into lines as wide as a frame; what is beyond the last is left out."""
    font, lines = _font(11), [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) <= _FRAME:
            lines[-1] = longer
        elif len(lines) < _MISSION_LINES:
            lines.append(word)
        else:
            lines[-1] += " …"
            break
    return lines


if __name__ == "__main__":
    main()
