"""Films of what an agent saw, thought and did."""

from __future__ import annotations

import functools
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxact.errors import JaxactError

_SMALLEST_FRAME = 320  # pixels; smaller frames are enlarged by a whole factor
_PANEL_WIDTH = 320
_MARGIN = 16
_ROW = 24
_MISSION_LINES = 3
_MISSION_TOP = _MARGIN
_NUMBERS_TOP = _MISSION_TOP + _MISSION_LINES * _ROW + 8
_BARS_TOP = _NUMBERS_TOP + 64

_BACKGROUND = (22, 24, 29)
_TRACK = (44, 48, 57)
_MUTED = (142, 150, 164)
_TEXT = (232, 235, 240)
_BAR = (86, 112, 158)
_CHOSEN = (255, 176, 59)


def annotate(
    frame: np.ndarray,
    *,
    action_names: Sequence[str],
    action_probabilities: Sequence[float] | np.ndarray,
    chosen: Sequence[int],
    value: float,
    reward: float,
    episode_return: float,
    step: int,
    mission: str | None = None,
) -> np.ndarray:
    """Puts a panel beside a frame: mission, step, value, rewards and the policy as bars.

    The size depends on the frame's size and the number of actions only, so all frames of one video
    match. Small frames are enlarged.

    Args:
      frame: uint8[H, W, 3].
      action_names: a name for each action; none, as for continuous actions, means no bars.
      action_probabilities: [len(action_names)] numbers in [0, 1].
      chosen: the indices of the actions taken, which are highlighted.
      value: the critic's estimate.
      reward: what the last step earned.
      episode_return: the sum of rewards so far.
      step: steps since the episode began.
      mission: the task in words; beyond three lines it is cut.

    Returns:
      uint8[H', W', 3] with even H' and W'.

    Raises:
      JaxactError: the frame is no uint8[H, W, 3], or names and probabilities differ in number.
    """
    if len(action_names) != len(action_probabilities):
        raise JaxactError(
            f"expected a probability for each of {len(action_names)} actions, "
            f"but got {len(action_probabilities)}"
        )
    world = _enlarge(_checked(frame))
    height = max(world.height, _BARS_TOP + _ROW * len(action_names) + _MARGIN)
    canvas = Image.new("RGB", (world.width + _PANEL_WIDTH, height + height % 2), _BACKGROUND)
    canvas.paste(world, (0, (canvas.height - world.height) // 2))
    draw = ImageDraw.Draw(canvas)
    left, right = world.width + _MARGIN, canvas.width - _MARGIN
    for row, line in enumerate(_wrap(mission or "", right - left)):
        draw.text((left, _MISSION_TOP + row * _ROW), line, _TEXT, _font(17))
    numbers = {
        "step": str(step),
        "value": f"{value:.2f}",
        "reward": f"{reward:.2f}",
        "return": f"{episode_return:.2f}",
    }
    for column, (name, text) in enumerate(numbers.items()):
        x = left + column * (right - left) // len(numbers)
        draw.text((x, _NUMBERS_TOP), name, _MUTED, _font(12))
        draw.text((x, _NUMBERS_TOP + 16), text, _TEXT, _font(17))
    for row, (name, probability) in enumerate(zip(action_names, action_probabilities, strict=True)):
        top = _BARS_TOP + row * _ROW
        _draw_bar(draw, (left, top, right), name, float(probability), row in chosen)
    return np.asarray(canvas)


def write_video(path: str | Path, frames: Sequence[np.ndarray] | np.ndarray, fps: int = 8) -> None:
    """Writes frames as an animated `.gif` or as an `.mp4` (H.264, for which sizes are made even).

    Args:
      path: where to; directories are created.
      frames: uint8[T, H, W, 3], or T frames of one shape.
      fps: frames per second.

    Raises:
      JaxactError: the suffix is neither, or the frames are none, not uint8 or not of one shape.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".mp4"):
        raise JaxactError(f"{path}: a video's name has to end in .gif or .mp4")
    stacked = _stack(frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".gif":
        path.write_bytes(encode_gif(stacked, fps))
        return
    import imageio.v2 as imageio

    odd = [(0, size % 2) for size in stacked.shape[1:3]]
    even = np.pad(stacked, [(0, 0), *odd, (0, 0)], mode="edge")
    writer: Any = imageio.get_writer(path, fps=fps, codec="libx264", macro_block_size=1)
    with writer:
        for frame in even:
            writer.append_data(frame)


def encode_gif(frames: Sequence[np.ndarray] | np.ndarray, fps: int = 8) -> bytes:
    """Returns frames, as for `write_video`, as an animated GIF that repeats for ever."""
    images = [
        Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE) for frame in _stack(frames)
    ]
    options: dict[str, Any] = {"duration": round(1000 / fps), "loop": 0, "disposal": 1}
    buffer = io.BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], **options)
    return buffer.getvalue()


def _checked(frame: np.ndarray) -> np.ndarray:
    frame = np.asarray(frame)
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
        raise JaxactError(f"expected a frame uint8[H, W, 3], but got {frame.dtype}{frame.shape}")
    return frame


def _stack(frames: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    checked = [_checked(frame) for frame in frames]
    if not checked:
        raise JaxactError("expected at least one frame for a video, but got none")
    shapes = {frame.shape for frame in checked}
    if len(shapes) > 1:
        raise JaxactError(f"expected frames of one shape, but got {sorted(shapes)}")
    return np.stack(checked)


def _enlarge(frame: np.ndarray) -> Image.Image:
    height, width = frame.shape[:2]
    factor = max(1, -(-_SMALLEST_FRAME // max(height, width)))
    image = Image.fromarray(frame).resize(
        (width * factor, height * factor), Image.Resampling.NEAREST
    )
    if image.width % 2:
        image = image.crop((0, 0, image.width + 1, image.height))
    return image


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _wrap(text: str, width: int) -> list[str]:
    """Breaks a text into at most so many lines as there is room for."""
    font = _font(17)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    if len(lines) > _MISSION_LINES:
        lines = lines[:_MISSION_LINES]
        lines[-1] = f"{lines[-1]} …"
    return [_shorten(line, width, 17) for line in lines]


def _shorten(text: str, width: int, size: int) -> str:
    if _font(size).getlength(text) <= width:
        return text
    text = text.removesuffix(" …")
    while text and _font(size).getlength(f"{text}…") > width:
        text = text[:-1].rstrip()
    return f"{text}…"


def _draw_bar(
    draw: ImageDraw.ImageDraw,
    place: tuple[int, int, int],
    name: str,
    probability: float,
    chosen: bool,
) -> None:
    """Draws name, bar and per cent; a probability out of range is drawn at its nearest end."""
    left, top, right = place
    start, end = left + 96, right - 44
    draw.text((left, top), _shorten(name, 88, 14), _CHOSEN if chosen else _TEXT, _font(14))
    box = (start, top + 2, end, top + 15)
    draw.rounded_rectangle(box, 3, _TRACK)
    length = round((end - start) * min(max(probability, 0.0), 1.0))
    if length >= 1:
        filled = (start, top + 2, start + length, top + 15)
        draw.rounded_rectangle(filled, min(3, length // 2), _CHOSEN if chosen else _BAR)
    color = _TEXT if chosen else _MUTED
    draw.text((right, top), f"{100 * probability:.0f} %", color, _font(14), anchor="ra")
