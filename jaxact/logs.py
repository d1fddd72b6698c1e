"""A run's reports: lines of JSON for programs, TensorBoard events for people."""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from PIL import Image

from jaxact.errors import JaxactError
from jaxact.video import encode_gif

METRICS = "metrics.jsonl"


class RunLog:
    """Writes `metrics.jsonl` and TensorBoard events into a run's directory.

    Args:
      directory: the run's; created if need be.
      resume_step: the step a run is resumed from. Whatever was logged beyond is dropped from
        `metrics.jsonl`, so that in the end it is that of a run without a break, and hidden in
        TensorBoard. Without it all that is there stays.
    """

    def __init__(self, directory: str | Path, *, resume_step: int | None = None) -> None:
        from tensorboardX import FileWriter
        from tensorboardX.proto.event_pb2 import Event, SessionLog

        directory = Path(directory)
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / METRICS
        _keep_until(path, math.inf if resume_step is None else resume_step)
        self._metrics = path.open("a", encoding="utf-8", newline="\n")
        self._events = FileWriter(str(directory))
        if resume_step is not None:
            start = SessionLog(status=SessionLog.START)
            self._events.add_event(Event(step=resume_step + 1, session_log=start))

    def scalars(self, step: int, values: Mapping[str, Any]) -> None:
        """Logs numbers: one line of JSON, which is on disk on return, and one event.

        Args:
          step: environment steps so far.
          values: scalars by tag, for example `"train/success"`. In JSON, which has no other word
            for them, NaN and infinities are null.
        """
        from tensorboardX.proto.summary_pb2 import Summary

        numbers = {tag: float(value) for tag, value in values.items()}
        finite = {tag: x if math.isfinite(x) else None for tag, x in numbers.items()}
        self._metrics.write(json.dumps({"step": step, **finite}, allow_nan=False) + "\n")
        self._metrics.flush()
        entries = [Summary.Value(tag=tag, simple_value=x) for tag, x in numbers.items()]
        self._events.add_summary(Summary(value=entries), step)

    def video(
        self, tag: str, step: int, frames: Sequence[np.ndarray] | np.ndarray, fps: int = 8
    ) -> None:
        """Shows uint8[T, H, W, 3] in TensorBoard, among the images."""
        height, width = np.shape(frames[0])[:2]
        self._image(tag, step, (height, width), encode_gif(frames, fps))

    def image(self, tag: str, step: int, image: np.ndarray) -> None:
        """Shows uint8[H, W, 3] in TensorBoard."""
        buffer = io.BytesIO()
        Image.fromarray(np.asarray(image, np.uint8)).save(buffer, "PNG")
        self._image(tag, step, image.shape[:2], buffer.getvalue())

    def text(self, tag: str, step: int, text: str) -> None:
        """Shows Markdown in TensorBoard."""
        from tensorboardX.summary import text as text_summary

        self._events.add_summary(text_summary(tag, text), step)

    def close(self) -> None:
        """Finishes both files."""
        self._metrics.close()
        self._events.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _image(self, tag: str, step: int, size: tuple[int, ...], encoded: bytes) -> None:
        from tensorboardX.proto.summary_pb2 import Summary

        picture = Summary.Image(
            height=size[0], width=size[1], colorspace=3, encoded_image_string=encoded
        )
        self._events.add_summary(Summary(value=[Summary.Value(tag=tag, image=picture)]), step)


def read_metrics(directory: str | Path) -> list[dict[str, Any]]:
    """Returns the lines of a run's `metrics.jsonl`: `"step"`, an int, and floats by tag.

    Null is read as NaN. A last line that was cut short, as of a run that was killed, is left out.

    Raises:
      JaxactError: there is no such file, or a line is not JSON.
    """
    path = Path(directory) / METRICS
    if not path.is_file():
        raise JaxactError(f"{directory} has no {METRICS}: nothing was logged there")
    read = []
    for number, line in enumerate(complete_lines(path), start=1):
        try:
            values = json.loads(line)
        except ValueError:
            raise JaxactError(f"{path}, line {number} is not valid JSON") from None
        read.append({tag: math.nan if x is None else x for tag, x in values.items()})
    return read


def read_hours(directory: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns the steps a run has logged and the hours it took until then, float64[n] each.

    The hours count from the opening of the log, and are those of the TensorBoard events. Pauses
    before a run was resumed are left out, and so is what was lost by them.

    Raises:
      JaxactError: there are no events.
    """
    from tensorboardX.proto.event_pb2 import SessionLog

    files = sorted(Path(directory).glob("events.out.tfevents.*"))
    if not files:
        raise JaxactError(f"{directory} has no TensorBoard events, which alone know the hours")
    steps, hours = [0.0], [0.0]
    for file in files:
        began, before = None, hours[-1]
        for event in _events(file):
            began = event.wall_time if began is None else began
            if event.session_log.status == SessionLog.START:
                while len(steps) > 1 and steps[-1] >= event.step:
                    del steps[-1], hours[-1]
                before = hours[-1]
            elif event.step > steps[-1]:
                steps.append(float(event.step))
                hours.append(before + (event.wall_time - began) / 3600)
    return np.array(steps), np.array(hours)


def _events(path: Path) -> Iterator[Any]:
    """Yields the events of a file in TensorBoard's format; one that was cut short is left out."""
    from tensorboardX.proto.event_pb2 import Event

    data, start = path.read_bytes(), 0
    while start + 12 <= len(data):  # length, its checksum, the event, its checksum
        (length,) = struct.unpack_from("<Q", data, start)
        end = start + 16 + length
        if end <= len(data):
            yield Event.FromString(data[start + 12 : end - 4])
        start = end


def complete_lines(path: Path) -> list[bytes]:
    """Returns a file's lines, without a last one that was cut short."""
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]


def _keep_until(path: Path, step: float) -> None:
    """Drops the lines beyond `step`, and one that was cut short, from the file's end."""
    if not path.exists():
        return
    lines = complete_lines(path)
    while lines and json.loads(lines[-1])["step"] > step:
        lines.pop()
    with path.open("rb+") as file:
        file.truncate(sum(map(len, lines)))
